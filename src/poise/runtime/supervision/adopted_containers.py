"""The containers of an agent that was killed: the next one adopts or kills them."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

from poise.clock import Clock
from poise.runtime.container.account import Account, rights_of
from poise.runtime.container.agent_link import Orphan, take_over
from poise.runtime.execution.counters import may_shrink
from poise.wire.address import agent_path, socket_path
from poise.wire.robots_here import peer_of

log = logging.getLogger(__name__)

ADOPT_LIMIT = 5.0
"""A container of an earlier agent asks to be adopted within this time [s]."""

_BUSY = -1
"""A process that nobody can connect to now: a stopped one, for instance."""


class AdoptedContainers:
    """Waits for the containers of an earlier agent, found by their sockets."""

    def __init__(
        self, folder: Path, clock: Clock, account: Account | None = None
    ) -> None:
        self._folder = folder
        self._account = account
        self._clock = clock
        self._until = clock.now() + ADOPT_LIMIT
        self._pidfds: dict[int, int] = {}
        self._left: dict[Path, int] = {}
        self.adopted: list[str] = []
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._listening.setblocking(False)
        with rights_of(account):
            for path in set(folder.glob("*.sock")) - {agent_path(folder)}:
                pid = _listener(path)
                if pid == _BUSY or (pid and self.watch(pid)):
                    self._left[path] = pid
            agent_path(folder).unlink(missing_ok=True)
            self._listening.bind(os.fspath(agent_path(folder)))

    def awaits(self, container: str) -> bool:
        """Return whether a container may run still, and so must not be started."""
        return socket_path(self._folder, container) in self._left

    def is_settled(self) -> bool:
        """Return whether all that were left have asked, or have ended."""
        return not self._left

    def fileno(self) -> int:
        """Return the descriptor where containers ask; negative: it is closed."""
        return self._listening.fileno()

    def pidfds(self) -> list[int]:
        """Return the descriptors that tell of ends of processes."""
        return list(self._pidfds)

    def moment(self) -> float:
        """Return when `give_up` has something to do [s]."""
        return self._until if self._left else float("inf")

    def next_orphan(self) -> tuple[Orphan, socket.socket, int] | None:
        """Return a container that asks to be adopted; None: none asks now."""
        while True:
            try:
                orphan, connection, stats_page = take_over(self._listening, Orphan)
            except OSError:
                return None
            if connection is None:  # no descriptor is free: it asks again
                continue
            is_foreign = self._is_foreign(orphan.pid) or may_shrink(stats_page)
            if not is_foreign and self.watch(orphan.pid):
                self._left.pop(socket_path(self._folder, orphan.container), None)
                self.adopted.append(orphan.container)
                return orphan, connection, stats_page
            if is_foreign:
                log.warning("process %d is not a container of this agent", orphan.pid)
            # or it has ended; where no descriptor is free, it asks again
            connection.close()
            os.close(stats_page)

    def ended(self, ready: set[int]) -> Iterator[int]:
        """Yield the processes that ended, of the descriptors that are ready."""
        for file in ready & self._pidfds.keys():
            pid = self._pidfds.pop(file)
            os.close(file)
            self._forget(pid)
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
            if pid in self._left.values():
                log.warning("process %d of an earlier agent does not respond", pid)
                with contextlib.suppress(ProcessLookupError):
                    signal.pidfd_send_signal(file, signal.SIGKILL)
        self._forget(_BUSY)  # it ends when it asks

    def close(self) -> None:
        """Kill what was not adopted, and adopt no more."""
        self._until = 0.0
        self.give_up()
        self._listening.close()
        with rights_of(self._account):
            agent_path(self._folder).unlink(missing_ok=True)

    def watch(self, pid: int) -> bool:
        """Watch a process for its end, from now on; return whether it still runs."""
        if pid in self._pidfds.values():
            return True
        if not self._is_foreign(pid):
            with contextlib.suppress(OSError):
                self._pidfds[os.pidfd_open(pid)] = pid
        return pid in self._pidfds.values()

    def _forget(self, pid: int) -> None:
        self._left = {path: of for path, of in self._left.items() if of != pid}

    def _is_foreign(self, pid: int) -> bool:
        """Return whether a process is another user's, whom a container may not end."""
        return self._account is not None and not self._account.owns(pid)


def _listener(path: Path) -> int:
    """Return the process that listens at a socket; 0: none does, or `_BUSY`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        if failure := asking.connect_ex(os.fspath(path)):
            return _BUSY if failure == errno.EAGAIN else 0
        return peer_of(asking)
