"""Ends what a container's process leaves behind: whatever its components forked.

It leads a session, so its process group can be killed, and adopts the orphans among its
descendants (a *subreaper*, prctl(2)); when it has ended they are the zygote's children.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import time
from collections.abc import Callable, Iterable
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_LOOK = 0.01
_LOOK_AT_ENDED = os.WEXITED | os.WNOHANG | os.WNOWAIT
UNCLAIMED = 10.0
"""An exit code for which nobody asked in this time [s] is nobody's."""


def adopt_orphans() -> None:
    """Let this process be the parent of descendants whose own parent ends."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def gain_no_rights() -> None:
    """Let this process and its descendants gain no rights by a setuid program."""
    ctypes.CDLL(None).prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)


def children(process: int = 0) -> set[int]:
    """Return the processes whose parent is a process; 0: this one."""
    return set().union(*_children_by_thread(process or os.getpid()).values())


def _children_by_thread(main: int) -> dict[int, set[int]]:
    """Return each thread's children, the main thread's last, as it inherits others'."""
    children: dict[int, set[int]] = {}
    tasks = Path(f"/proc/{main}/task")
    with contextlib.suppress(OSError):
        threads = {int(folder.name) for folder in tasks.iterdir()}
        for thread in (*(threads - {main}), main):
            with contextlib.suppress(OSError):  # it has ended
                text = (tasks / str(thread) / "children").read_text()
                children[thread] = set(map(int, text.split()))
    return children


class Orphans:
    """Reaps the orphans that this process adopted and that have ended.

    The kernel gives orphans to the main thread, which forks nothing here, and the
    children of threads that end. So no child of another thread is an orphan, and a
    child in this session may be waited for: it is reaped when nobody did for
    `UNCLAIMED`.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._forked: set[int] = set()
        self._ended: dict[int, float] = {}

    def reap(self) -> None:
        """Look, and reap; call it about once a second."""
        by_thread = _children_by_thread(os.getpid())
        adopted = by_thread.pop(os.getpid(), set())
        forked = set().union(*by_thread.values())
        # a child that has just got another parent thread may be in neither list
        self._forked = {child for child in forked | self._forked if _is_child(child)}
        before, self._ended = self._ended, {}
        for child in adopted - self._forked:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                if not os.waitid(os.P_PID, child, _LOOK_AT_ENDED):
                    continue
                since = before.get(child, self._clock())
                is_foreign = os.getsid(child) not in {os.getsid(0), child}
                if is_foreign or self._clock() - since >= UNCLAIMED:
                    os.waitpid(child, os.WNOHANG)
                else:
                    self._ended[child] = since


def _is_child(process: int) -> bool:
    try:
        os.waitid(os.P_PID, process, _LOOK_AT_ENDED)
    except ChildProcessError:
        return False
    return True


def kill_all(processes: Iterable[int]) -> None:
    """Kill processes, and the process groups that they lead."""
    for process in processes:
        for kill in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(process, signal.SIGKILL)


def end_children(limit: float) -> None:
    """Kill all descendants, and wait up to `limit` [s] until they are gone."""
    deadline = time.monotonic() + limit
    while (left := children()) and time.monotonic() < deadline:
        kill_all(left)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        time.sleep(_LOOK)
