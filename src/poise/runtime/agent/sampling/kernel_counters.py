"""What the kernel counts: CPU time, memory and waiting."""

from __future__ import annotations

import contextlib
import os
import time
from mmap import PAGESIZE
from pathlib import Path

CPU_FILE = "POISE_CPU_FILE"
"""Environment variable of an emulated computer: its cgroup's CPU time; empty: nobody
counts it. Not set on a real computer, where the kernel counts all."""

_TICK = 1 / os.sysconf("SC_CLK_TCK")
_BUSY = (1, 2, 3, 6, 7)
"""Of a CPU's times in /proc/stat: user, nice, system, and those of interrupts."""


class ComputerCpu:
    """Reads the CPU time of all programs of this computer."""

    def __init__(self) -> None:
        path = os.environ.get(CPU_FILE)
        self._is_group = path is not None
        self._file = Path(path or "/proc/stat") if path != "" else None

    def read(self) -> float | None:
        """Return the CPU time so far [s].

        None when nobody counts it: on an emulated computer without a cgroup.
        """
        if self._file is None:
            return None
        try:
            text = self._file.read_text()
            return _of_group(text) if self._is_group else _of_all(text)
        except (OSError, ValueError, IndexError):
            return None


def _of_all(stat: str) -> float:
    times = stat.partition("\n")[0].split()
    return sum(int(times[i]) for i in _BUSY) * _TICK


def _of_group(usage: str) -> float:
    """Return what a cgroup used: version 1 counts in ns, version 2 in us."""
    if usage.startswith("usage_usec "):
        return int(usage.split()[1]) / 1e6
    return int(usage) / 1e9


class Processes:
    """What the kernel knows of processes.

    Parameters
    ----------
    proc
        Where its files are.
    """

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc

    def is_stopped(self, pid: int) -> bool:
        """Return whether a process was stopped by a signal or a debugger."""
        try:
            text = (self._proc / str(pid) / "stat").read_text()
        except OSError:
            return False
        return text.rpartition(")")[2].split()[0] in {"T", "t"}

    def has_one_that_goes_on(self, pid: int) -> bool:
        """Return whether a thread is runnable, or waits for a disk or for memory."""
        for thread in (self._proc / str(pid) / "task").glob("*/stat"):
            with contextlib.suppress(OSError):  # it has ended
                if thread.read_text().rpartition(")")[2].split()[0] in {"R", "D"}:
                    return True
        return False

    def cpu(self, pid: int) -> float:
        """Return the CPU time of a process so far [s]; 0 when it has ended."""
        try:
            return time.clock_gettime(~pid * 8 | 2)  # CPUCLOCK_SCHED of a process
        except OSError:
            return 0.0

    def delays(self, pid: int) -> dict[int, float]:
        """Return how long each thread was runnable without a CPU [s], by thread.

        Empty where the kernel does not count that.
        """
        found = {}
        for thread in (self._proc / str(pid) / "task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # it has ended
                waited = int(thread.read_text().split()[1])
                found[int(thread.parent.name)] = waited * 1e-9
        return found


def private_memory(process: int) -> int:
    """Return what a process has allocated [bytes]; 0 when it has ended.

    Files that it maps are not in it: the kernel drops these when memory is short.
    """
    try:
        fields = Path(f"/proc/{process}/statm").read_bytes().split()
    except OSError:
        return 0
    return (int(fields[1]) - int(fields[2])) * PAGESIZE


def resident_memory(process: int) -> int:
    """Return what a process holds, shared or not [bytes]; 0 when it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_bytes().split()[1]) * PAGESIZE
    except OSError:
        return 0


def proportional_memory(process: int) -> int:
    """Return a process's proportional set size [bytes]; 0 when nobody tells."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_bytes()
    except OSError:
        return 0
    for line in text.splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0
