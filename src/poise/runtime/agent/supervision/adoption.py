"""The containers that an agent which was killed has left, and the next one adopts.

An agent keeps in its folder what must be known after it was killed (`AgentState`). The
next one waits until the containers that still run ask to be adopted, and kills those
that do not within `ADOPT_LIMIT`, so that nothing runs twice.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import signal
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import msgspec

from poise.clock import Clock
from poise.errors import UsageError
from poise.runtime.agent.supervision.agent_state import AgentState
from poise.runtime.container.agent_link import Orphan, take_over
from poise.wire.connections.socket_path import agent_path, socket_path
from poise.wire.records.requests import PROTOCOL

log = logging.getLogger(__name__)

ADOPT_LIMIT = 5.0
"""A container of an earlier agent asks to be adopted within this time [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")


class AgentFolder:
    """The folder of an agent, which one process uses at a time.

    Raises
    ------
    UsageError
        Another agent uses it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "state"
        self._lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        self._boot = _BOOT.read_text().strip()
        self._kept = AgentState()
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
            kept = msgspec.msgpack.decode(self._path.read_bytes(), type=AgentState)
        except FileNotFoundError:
            return AgentState()
        except (OSError, msgspec.DecodeError) as error:
            log.warning("what an earlier agent kept in %s: %s", self._path, error)
            return AgentState()
        is_valid = kept.boot == self._boot and kept.protocol == PROTOCOL
        return kept if is_valid else AgentState()

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed; `trouble` says why not."""
        state = msgspec.structs.replace(state, boot=self._boot)
        if state == self._kept:
            return
        new = self._path.with_suffix(".new")
        try:
            new.write_bytes(msgspec.msgpack.encode(state))
            new.replace(self._path)
        except OSError as error:
            self.forget()  # better nothing than what holds no more
            self._kept = AgentState()
            self.trouble = (
                f"the agent cannot keep what should run: {error}; if it is killed, the "
                "next one waits for its manager"
            )
        else:
            self._kept, self.trouble = state, ""

    def forget(self) -> None:
        """Leave nothing for the next agent."""
        self._path.unlink(missing_ok=True)


class AdoptedContainers:
    """Waits for the containers of an earlier agent, and for the ends of adopted ones.

    A container of this computer listens at a socket in the folder for as long as it
    lives: so those that were left are known, whatever an agent could keep.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder = folder
        self._clock = clock
        self._until = clock.now() + ADOPT_LIMIT
        self._pidfds: dict[int, int] = {}
        self._left: dict[int, Path] = {}
        self.num_adopted = 0
        for path in set(folder.glob("*.sock")) - {agent_path(folder)}:
            pid = _listener(path)
            if pid and self._watch(pid):
                self._left[pid] = path
        agent_path(folder).unlink(missing_ok=True)
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._listening.bind(os.fspath(agent_path(folder)))
        self._listening.setblocking(False)

    def awaits(self, container: str) -> bool:
        """Return whether a container may run still, and so must not be started."""
        return socket_path(self._folder, container) in self._left.values()

    def is_settled(self) -> bool:
        """Return whether all that were left have asked, or have ended."""
        return not self._left

    def files(self) -> list[int]:
        """Return the descriptors to wait for."""
        listening = self._listening.fileno()
        return [*([listening] if listening >= 0 else []), *self._pidfds]

    def moment(self) -> float:
        """Return when `give_up` has something to do [s]."""
        return self._until if self._left else float("inf")

    def orphans(self, ready: set[int]) -> Iterator[tuple[Orphan, socket.socket, int]]:
        """Yield containers that ask to be adopted, as `take_over` does.

        Parameters
        ----------
        ready
            The descriptors that have something to read.
        """
        if self._listening.fileno() not in ready:
            return
        with contextlib.suppress(OSError):  # until no more have come
            while True:
                orphan, connection, stats_page = take_over(self._listening, Orphan)
                if connection is None:  # no descriptor is free: it asks again
                    continue
                is_left = self._left.pop(orphan.pid, None) is not None
                if is_left or self._watch(orphan.pid):
                    self.num_adopted += 1
                yield orphan, connection, stats_page

    def ended(self, ready: set[int]) -> Iterator[int]:
        """Yield the processes that ended, of the descriptors that are ready."""
        for file in ready & self._pidfds.keys():
            pid = self._pidfds.pop(file)
            os.close(file)
            self._left.pop(pid, None)
            # what it leaves behind, if its zygote is gone, too
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)
            yield pid

    def give_up(self) -> None:
        """Kill the containers that did not ask in time; they end soon."""
        if self._clock.now() < self.moment():
            return
        self._until = float("inf")
        for file, pid in self._pidfds.items():
            if pid in self._left:
                log.warning("process %d of an earlier agent does not respond", pid)
                with contextlib.suppress(ProcessLookupError):
                    signal.pidfd_send_signal(file, signal.SIGKILL)

    def close(self) -> None:
        """Kill what was not adopted, and adopt no more."""
        self._until = 0.0
        self.give_up()
        self._listening.close()
        agent_path(self._folder).unlink(missing_ok=True)

    def _watch(self, pid: int) -> bool:
        """Watch a process for its end, from now on; return whether it still runs."""
        if pid in self._pidfds.values():
            return True
        with contextlib.suppress(OSError):
            self._pidfds[os.pidfd_open(pid)] = pid
        return pid in self._pidfds.values()


def _listener(path: Path) -> int:
    """Return the process that listens at a socket; 0: none does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        if asking.connect_ex(os.fspath(path)):
            return 0
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        return int(struct.unpack("3i", credentials)[0])
