"""Reads and writes the folder of an agent, on a thread of its own.

A disk may not answer for seconds. The agent and its containers go on meanwhile, and its
status says so.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from poise import threads
from poise.clock import Clock
from poise.runtime.agent.agent_folder import AgentFolder
from poise.runtime.agent.checkpoint_files import CheckpointFiles
from poise.runtime.agent.supervision.agent_state import AgentState
from poise.runtime.agent.surroundings import Reply
from poise.runtime.hosting.output import forget_output, read_output
from poise.wire.records.checkpoints import CheckpointCopy
from poise.wire.records.deployment import Deployment
from poise.wire.records.output import ReadOutput
from poise.wire.records.requests import Accepted, Answer, Refused

log = logging.getLogger(__name__)

_MOST = 100
"""The most jobs that wait for the disk."""
_SLOW = 1.0
"""A disk that does not answer for longer is in trouble [s]."""
_STOP_LIMIT = 2.0
_NOTHING = Deployment(generation=0, containers=())


class DiskThread:
    """The `AgentDisk` of a real computer.

    Parameters
    ----------
    path, folder
        The folder, and what is kept in it for the next agent.
    """

    def __init__(
        self,
        path: Path,
        folder: AgentFolder,
        checkpoints: CheckpointFiles,
        clock: Clock,
    ) -> None:
        self._path = path
        self._folder = folder
        self._checkpoints = checkpoints
        self._clock = clock
        self._kept: AgentState | None = None
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
            log.warning("folder %s: the disk does not answer; it is left", self._path)

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed; the last one counts."""
        if state != self._kept:
            self._kept = state
            self._put("state", lambda: self._keep(state))

    def forget(self) -> None:
        """Leave nothing to the next agent: nothing runs any more."""
        self._kept = None
        self._put("state", self._forget)

    def serve(self, request: ReadOutput | CheckpointCopy, reply: Reply) -> None:
        """Read or write what a manager asks for; answers when that is done."""
        if not self._put(object(), lambda: reply(self._use(request))):
            reply(Refused(f"its disk is too slow: {_MOST} requests wait for it"))

    def keep_only(self, wanted: Deployment) -> None:
        """Remove the checkpoints of all that is not wanted, and send the others."""
        self._checkpoints.send_only(wanted)
        self._put("checkpoints", lambda: self._checkpoints.remove_all_but(wanted))

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
        if self._folder.trouble:
            self._kept = None  # it is tried again

    def _forget(self) -> None:
        self._folder.forget()
        forget_output(self._path)
        self._checkpoints.remove_all_but(_NOTHING)

    def _use(self, request: ReadOutput | CheckpointCopy) -> Answer:
        try:
            if isinstance(request, ReadOutput):
                return read_output(self._path, request)
            self._checkpoints.write(request)
        except OSError as error:
            return Refused(f"it cannot use its folder: {error}")
        return Accepted()
