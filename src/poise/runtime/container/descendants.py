"""Ends what a container's process leaves behind: whatever its components forked.

A container leads a session of its own, so its process group can be killed. It also
adopts the orphans among its descendants (a *subreaper*, prctl(2)), so that none gets
away: when it has ended, they become children of the zygote, which has no others.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36
_LOOK = 0.01


def adopt_orphans() -> None:
    """Let this process be the parent of descendants whose own parent ends."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def lead_session() -> None:
    """Put this process into a session and process group of its own."""
    os.setsid()


def children() -> set[int]:
    """Return the processes whose parent is this process."""
    found: set[int] = set()
    for file in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # the thread has ended
            found.update(map(int, file.read_text().split()))
    return found


def reap_adopted() -> None:
    """Reap the orphans that this process adopted and that have ended.

    An exit code that a component waits for is left alone: what this process forks is in
    its own session, or leads one. A child in any other session was forked by another
    process. So an orphan that stayed in this session is reaped with the container only.
    """
    own = os.getsid(0)
    for child in children():
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            if os.getsid(child) not in {own, child}:
                os.waitpid(child, os.WNOHANG)


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
