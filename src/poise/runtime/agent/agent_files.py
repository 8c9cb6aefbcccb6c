"""Reads and writes the folder of an agent, on a thread of its own.

A disk may not answer for seconds; the agent and its containers go on meanwhile.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import threading
import weakref
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import msgspec

from poise import threads
from poise.clock import Clock, boot_id, boot_time
from poise.decoding import from_msgpack
from poise.errors import RunError, UsageError
from poise.runtime.agent.surroundings import AgentState, Reply
from poise.runtime.container.account import Account, rights_of
from poise.runtime.hosting.output import forget_output, read_output
from poise.user_folders import write_private
from poise.wire.codec import MALFORMED
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    ReadOutput,
    Refused,
    age_of,
    checkpoint_path,
)
from poise.wire.robots_here import AgentAddresses, forget, hold, note, noted_of

log = logging.getLogger(__name__)


class AgentFolder:
    """The folder of an agent; UsageError when another process uses it."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "state"
        hold(folder)  # for as long as anything that is forked here lives
        self._lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        self._boot = boot_id()
        self.trouble = ""
        try:
            # a lock of this process alone: what it forks does not hold it
            fcntl.lockf(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise UsageError(
                f"another agent uses the folder {folder}: end that one, or choose "
                "another with --folder"
            ) from None

    def left(self) -> AgentState:
        """Return what an agent that was killed has kept here; nothing: as it began."""
        try:
            state = from_msgpack(self._path.read_bytes(), AgentState)
        except FileNotFoundError:
            return AgentState()
        except (OSError, *MALFORMED) as error:
            log.warning(
                "the state that an earlier agent saved in %s cannot be read: %s",
                self._path,
                error,
            )
            return AgentState()
        is_valid = state.boot == self._boot and state.is_understood
        return state if is_valid else AgentState()

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know; `trouble` says why not."""
        state = msgspec.structs.replace(state, boot=self._boot)
        try:
            write_private(self._path, msgspec.msgpack.encode(state))
        except OSError as error:
            self.trouble = (
                f"the agent cannot save its deployment: {error}; if it is killed, the "
                "next one waits for its manager"
            )
            with contextlib.suppress(OSError):
                self.forget()  # better nothing than what holds no more
        else:
            self.trouble = ""

    def forget(self) -> None:
        """Leave nothing for the next agent."""
        self._path.unlink(missing_ok=True)


_NOTHING = Deployment(generation=0, containers=())
POLL_EVERY = 0.1
"""New checkpoints are looked for this often [s]."""
_JOIN_LIMIT = 1.0


class _SentFile:
    """A checkpoint that was sent; while this lives, no new file gets its number."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._file)
        self.number, self.modified_ns = os.fstat(self._file).st_ino, 0

    def read(self) -> bytes:
        with open(self._file, "rb", closefd=False) as file:
            return file.read()


class CheckpointFiles:
    """The checkpoints in the folder of containers, which run as `account`."""

    def __init__(
        self,
        folder: Path,
        send: Callable[[CheckpointCopy], object],
        account: Account | None = None,
    ) -> None:
        self.folder = folder
        self.account = account
        self._send = send
        self._wanted: tuple[tuple[str, int], ...] = ()
        self._sent: dict[tuple[str, int], _SentFile] = {}
        self._ended = threading.Event()
        self._has_work = threading.Event()
        self._modified: dict[tuple[str, int], float] = {}
        self._thread = threads.daemon(self._main, "checkpoints", again=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """Send no more."""
        self._ended.set()
        self._has_work.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_LIMIT)

    def send_only(self, wanted: Deployment) -> None:
        """Send the checkpoints of what is wanted from now on."""
        self._wanted = tuple(c.key for c in wanted.components if c.checkpoint)
        if self._wanted:
            self._has_work.set()

    def remove_all_but(self, wanted: Deployment) -> None:
        """Remove the checkpoints of what is not wanted; raises OSError."""
        kept = {
            checkpoint_path(self.folder, c.name, c.epoch) for c in wanted.components
        }
        with rights_of(self.account):
            for path in set(self.folder.glob("*.checkpoint")) - kept:
                path.unlink(missing_ok=True)

    def remove(self, of: Collection[tuple[str, int]]) -> None:
        """Remove those of these names and epochs; raises OSError."""
        with rights_of(self.account):
            for name, epoch in of:
                checkpoint_path(self.folder, name, epoch).unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove those of another start of the robot, which has the same epochs."""
        try:
            self.remove_all_but(_NOTHING)
        except OSError as error:
            log.warning("old checkpoints in %s stay: %s", self.folder, error)

    def resend(self) -> None:
        """Send all again: there is another manager."""
        self._sent = {}

    def write(self, copy: CheckpointCopy) -> None:
        """Keep a copy for a component that is to start here; OSError: there is none."""
        path = checkpoint_path(self.folder, copy.component, copy.epoch)
        write_private(path, copy.data or b"", boot_time() - copy.age)

    def age(self, component: str, epoch: int) -> float | None:
        """Return the age of a checkpoint [s]; None: there is none. No disk is used."""
        modified = self._modified.get((component, epoch))
        return None if modified is None else age_of(modified)

    def _main(self) -> None:
        self._has_work.wait()  # most robots have no checkpoints
        with rights_of(self.account):
            while not self._ended.wait(POLL_EVERY):
                for copy in self._news():
                    self._send(copy)

    def _news(self) -> Iterator[CheckpointCopy]:
        sent = self._sent  # for another manager, `resend` begins a new one
        for key in sent.keys() - {*self._wanted}:
            del sent[key]
        self._modified = {k: v for k, v in self._modified.items() if k in self._wanted}
        for component, epoch in self._wanted:
            path = checkpoint_path(self.folder, component, epoch)
            with contextlib.suppress(OSError):  # there is none yet
                status = path.stat()
                self._modified[component, epoch] = status.st_mtime
                file = sent.get((component, epoch))
                # the same file has the same content: only its age is news
                is_same = file is not None and file.number == status.st_ino
                if file is None or not is_same:
                    file = _SentFile(path)
                elif file.modified_ns == status.st_mtime_ns:
                    continue
                yield CheckpointCopy(
                    component=component,
                    epoch=epoch,
                    data=None if is_same else file.read(),
                    age=age_of(status.st_mtime),
                )
                file.modified_ns = status.st_mtime_ns
                sent[component, epoch] = file


_MOST = 100
"""The most jobs that wait for the disk."""
_SLOW = 1.0
"""A disk that does not answer for longer is in trouble [s]."""
_STOP_LIMIT = 2.0


class AgentNote:
    """Notes where a robot's agents are while it is at work, unless a manager does."""

    def __init__(self, robot: str, keys: str) -> None:
        self._robot = robot
        self._keys = keys  # a folder to ask them with; empty: a person's own
        self._ours: AgentAddresses | None = None
        self._trouble = ""

    def update(self, state: AgentState | None) -> None:
        """Write or remove it; a trouble is logged once."""
        trouble, self._trouble = self._trouble, ""
        try:
            self._update(state)
        except (RunError, OSError) as error:
            self._trouble = str(error)
            if trouble != self._trouble:
                log.warning("commands on this computer find no robot: %s", error)

    def _update(self, state: AgentState | None) -> None:
        wanted = state.wanted if state is not None else None
        claim = state.claim if state is not None else None
        noted = noted_of(self._robot)
        if claim is None or wanted is None or wanted.is_last:
            if noted is not None and noted == self._ours:
                forget(self._robot)
        elif noted is None or noted == self._ours:
            self._ours = AgentAddresses(self._robot, claim.agents, self._keys)
            if noted != self._ours:
                note(self._ours)


class DiskThread:
    """The `AgentDisk` of a real computer."""

    def __init__(
        self,
        folder: AgentFolder,
        checkpoints: CheckpointFiles,
        clock: Clock,
        note: AgentNote | None = None,
    ) -> None:
        self._path, self._account = checkpoints.folder, checkpoints.account
        self._folder = folder
        self._note = note
        self._checkpoints = checkpoints
        self._clock = clock
        self._saved: AgentState | None = None
        self._jobs: dict[object, Callable[[], object]] = {}
        self._changed = threading.Condition()
        self._busy_since = float("inf")
        self._is_stopping = False
        self._thread = threads.daemon(self._main, "disk", again=True)

    def start(self) -> None:
        """Begin with what waits."""
        self._thread.start()
        self._checkpoints.start()

    def stop(self) -> None:
        """End when all is done, or after a limit; then the log says so."""
        self._checkpoints.stop()
        with self._changed:
            self._is_stopping = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(_STOP_LIMIT)
        if self._thread.is_alive():
            log.warning(
                "folder %s: the disk does not answer; its jobs are abandoned",
                self._path,
            )

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed; the last one counts."""
        if state != self._saved:
            self._saved = state
            self._put("state", lambda: self._keep(state))

    def forget(self) -> None:
        """Leave nothing to the next agent: nothing runs any more."""
        self._saved = None
        self._put("state", self._forget)

    def serve(self, request: ReadOutput | CheckpointCopy, reply: Reply) -> None:
        """Read or write what a manager asks for; answers when that is done."""
        if not self._put(object(), lambda: reply(self._use(request))):
            reply(Refused(f"its disk is too slow: {_MOST} requests wait for it"))

    def keep_only(self, wanted: Deployment) -> None:
        """Remove the checkpoints of all that is not wanted, and send the others."""
        self._checkpoints.send_only(wanted)
        self._put("checkpoints", lambda: self._checkpoints.remove_all_but(wanted))

    def remove_checkpoints(self, of: Collection[tuple[str, int]]) -> None:
        """Remove the checkpoints of these names and epochs, if the disk is not slow."""
        self._put(object(), lambda: self._checkpoints.remove(of))

    def resend(self) -> None:
        """Send all checkpoints again: there is another manager."""
        self._checkpoints.resend()

    def checkpoint_age(self, component: str, epoch: int) -> float | None:
        """Return how old the last checkpoint is [s]; None: there is none."""
        return self._checkpoints.age(component, epoch)

    def trouble(self) -> str:
        """Return what is wrong with it, in words; empty: nothing is."""
        seconds = self._clock.now() - self._busy_since
        if seconds > _SLOW:
            return (
                f"the disk of {self._path} has not answered for {seconds:.0f} s: what "
                "the agent must know if it is killed is not kept meanwhile"
            )
        return self._folder.trouble

    def _put(self, key: object, job: Callable[[], object]) -> bool:
        """Queue a job, in place of one with the same key; return whether it fits."""
        with self._changed:
            # of those with a name there are only two
            if not isinstance(key, str) and len(self._jobs) >= _MOST:
                return False
            self._jobs.pop(key, None)
            self._jobs[key] = job
            self._changed.notify()
        return True

    def _main(self) -> None:
        while True:
            with self._changed:
                self._busy_since = float("inf")
                while not self._jobs:
                    if self._is_stopping:
                        return
                    self._changed.wait()
                job = self._jobs.pop(next(iter(self._jobs)))
                self._busy_since = self._clock.now()
            try:
                job()
            except OSError as error:  # what was to be removed stays until the next time
                log.warning("the agent cannot use its folder: %s", error)

    def _keep(self, state: AgentState) -> None:
        self._folder.keep(state)
        if self._note is not None:
            self._note.update(state)
        if self._folder.trouble:
            self._saved = None  # it is tried again

    def _forget(self) -> None:
        self._folder.forget()
        if self._note is not None:
            self._note.update(None)
        with rights_of(self._account):
            forget_output(self._path)
        self._checkpoints.remove_all_but(_NOTHING)

    def _use(self, request: ReadOutput | CheckpointCopy) -> Answer:
        try:
            with rights_of(self._account):
                if isinstance(request, ReadOutput):
                    return read_output(self._path, request)
                self._checkpoints.write(request)
        except OSError as error:
            return Refused(f"it cannot use its folder: {error}")
        return Accepted()
