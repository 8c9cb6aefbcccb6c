"""Ends processes in stages: ask, wait, kill, wait."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from poise.errors import RunError
from poise.kernel_counters import stat_of

PREFIX = "poise"


class Owner(Struct, frozen=True):
    """A process: its number, used again later, and start [ticks since boot]."""

    pid: int
    started: int

    @classmethod
    def this(cls) -> Owner:
        """Return the calling process."""
        return cls(os.getpid(), _started(os.getpid()) or 0)

    def is_alive(self) -> bool:
        """Return whether this process still runs."""
        return _started(self.pid) == self.started

    def __str__(self) -> str:
        return f"{PREFIX}-{self.pid}-{self.started}"


def _started(pid: int) -> int | None:
    # qemu-user makes up the times of `/proc/PID/stat` for a process itself
    stat = stat_of(Path(f"/proc/{pid}/task/{pid}"))
    return None if stat is None or stat.state in "ZX" else stat.started


ASK = 2.0
"""Time limit for processes to end after SIGTERM [s]."""
KILL = 5.0
"""Time limit for processes to end after SIGKILL [s]."""
_POLL_EVERY = 0.01

MARK = "POISE_EMULATION"
"""The environment variable that all processes of an emulated computer inherit."""


def stop(processes: Callable[[], Sequence[int]], ask: float = ASK) -> None:
    """End all that `processes` returns at each call; kill them after `ask` [s]."""
    if ask and not _gone_within(processes, signal.SIGTERM, ask, again=False):
        ask = 0.0
    if not ask and not _gone_within(processes, signal.SIGKILL, KILL, again=True):
        message = f"processes {list(processes())} still run {KILL:g} s after SIGKILL"
        raise RunError(message)


def freeze(processes: Callable[[], Sequence[int]]) -> None:
    """Stop `processes()` and what they start; RunError: there are more and more."""
    end = time.monotonic() + KILL
    frozen: set[int] = set()
    while new := set(processes()) - frozen:
        _send(sorted(new), signal.SIGSTOP)
        frozen |= new
        if time.monotonic() > end:
            thaw(sorted(frozen))
            message = f"processes still start others, {KILL:g} s after being stopped"
            raise RunError(message)


def thaw(processes: Sequence[int]) -> None:
    """Let frozen processes go on."""
    _send(processes, signal.SIGCONT)


def marked(mark: str) -> list[int]:
    """Return the processes whose environment contains `mark`."""
    sought = f"{MARK}={mark}".encode()
    return [
        int(folder.name)
        for folder in Path("/proc").iterdir()
        if folder.name.isdecimal() and sought in _environment(folder)
    ]


def _gone_within(
    processes: Callable[[], Sequence[int]],
    sent: signal.Signals,
    seconds: float,
    *,
    again: bool,
) -> bool:
    end = time.monotonic() + seconds
    _send(processes(), sent)
    while left := processes():
        if time.monotonic() > end:
            return False
        if again:
            _send(left, sent)
        time.sleep(_POLL_EVERY)
    return True


def _send(pids: Sequence[int], sent: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, sent)


def _environment(folder: Path) -> list[bytes]:
    try:
        # A zombie has an empty environment.
        return (folder / "environ").read_bytes().split(b"\0")
    except OSError:  # it has ended, or belongs to another user
        return []
