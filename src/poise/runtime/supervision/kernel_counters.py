"""What the kernel counts: CPU time, memory and waiting.

A leak grows all the time: memory counts as growing when it grows from each fifth of a
time to the next, and beyond all that it was within the minute before.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from mmap import PAGESIZE
from pathlib import Path
from statistics import mean, median

from msgspec import Struct

from poise.cgroup_mounts import NO_LIMIT, memory_group

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
        """Return the CPU time so far [s]; None: nobody counts it."""
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
    """What the kernel knows of processes."""

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
        """Return each thread's time runnable without a CPU [s]; empty: not counted."""
        found = {}
        for thread in (self._proc / str(pid) / "task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # it has ended
                waited = int(thread.read_text().split()[1])
                found[int(thread.parent.name)] = waited * 1e-9
        return found


def private_memory(process: int) -> int:
    """Return what a process has allocated [bytes], without files; 0: it has ended."""
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


_FILES = (
    ("memory.max", "memory.current", "inactive_file"),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Of a cgroup, version 2 and 1: its limit, its use, and what of it is only a cache."""


class MemoryRoom(Struct, frozen=True):
    """A limit of this computer's memory, and how far away it is [bytes]."""

    limit: float
    free: float


class ComputerMemory:
    """Reads the limits that hold for this process and its children."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._meminfo = proc / "meminfo"
        mount = memory_group(proc)
        self._groups: tuple[Path, ...] = ()
        if mount is not None:
            above = [p for p in mount.own.parents if p.is_relative_to(mount.top)]
            self._groups = (mount.own, *above)

    def read(self) -> MemoryRoom | None:
        """Return the nearest limit; None when nothing is known."""
        return min(self._rooms(), key=lambda room: room.free, default=None)

    def _rooms(self) -> Iterator[MemoryRoom]:
        with contextlib.suppress(OSError, ValueError, KeyError):
            amounts = _table(self._meminfo)
            total, free = amounts["MemTotal:"], amounts["MemAvailable:"]
            yield MemoryRoom(1024.0 * total, 1024.0 * free)
        for group in self._groups:
            for limit_file, use, cache in _FILES:
                # "max" is no number: there is no limit
                with contextlib.suppress(OSError, ValueError):
                    limit = int((group / limit_file).read_text())
                    if limit >= NO_LIMIT:
                        continue
                    used = int((group / use).read_text())
                    spare = _table(group / "memory.stat").get(cache, 0)
                    yield MemoryRoom(limit, max(0.0, limit - used + spare))


def _table(file: Path) -> dict[str, int]:
    """Return the numbers of a file with a name and a number in each line."""
    lines = (line.split() for line in file.read_text().splitlines())
    return {line[0]: int(line[1]) for line in lines if len(line) > 1}


READ_EVERY = 1.0
"""Memory is read this often [s]."""
_FIFTH = 3
"""Readings in each fifth of the time that is looked at."""
_ALL = 5 * _FIFTH
_COARSE = 4
"""What grows in lumps is seen over a longer time, with every fourth reading."""
_CONFIRMED = 3
"""It begins to grow, or ceases, when as many readings in succession say so."""
_PART = 0.6
"""From each fifth to the next it grows by at least this part of the mean growth."""
_BEFORE = 60.0
"""It must exceed all that it was within this time before [s]."""
_LEAST = 64 * 1024.0
"""Slower growth is none [bytes/s]."""


class MemoryGrowth:
    """Follows the memory of one container."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._read_at = float("-inf")
        self._count = self._unlike = 0
        self._fine, self._coarse = _Trend(READ_EVERY), _Trend(_COARSE * READ_EVERY)

    def is_due(self, now: float) -> bool:
        """Return whether the memory should be read at `now` [s]."""
        return now - self._read_at >= READ_EVERY

    def update(self, now: float, size: float) -> None:
        """Add a reading [bytes] that was due at `now` [s]."""
        self._read_at = now
        self._fine.add(now, size)
        if self._count % _COARSE == 0:
            self._coarse.add(now, size)
        self._count += 1
        rate = self._fine.rate() or self._coarse.rate()
        self._unlike = 0 if bool(rate) == bool(self.rate) else self._unlike + 1
        if self._unlike == 0 or self._unlike >= _CONFIRMED:
            self.rate, self._unlike = rate, 0


class _Trend:
    """The last readings, one each `every` seconds."""

    def __init__(self, every: float) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=_ALL)
        self._before: deque[float] = deque(maxlen=round(_BEFORE / every))

    def add(self, now: float, size: float) -> None:
        if len(self._last) == _ALL:
            self._before.append(self._last[0][1])
        self._last.append((now, size))

    def rate(self) -> float:
        """Return the growth [bytes/s]: the median of the slopes of all pairs."""
        if len(self._last) < _ALL:
            return 0.0
        readings = list(self._last)
        if not _grows([size for _, size in readings], max(self._before, default=0.0)):
            return 0.0
        pairs = combinations(readings, 2)
        rate = median((b - a) / (later - at) for (at, a), (later, b) in pairs)
        return rate if rate >= _LEAST else 0.0


def _grows(sizes: Sequence[float], highest: float) -> bool:
    """Return whether each fifth is higher than the one before, and than `highest`."""
    starts = range(0, len(sizes), _FIFTH)
    levels = [median(sizes[at : at + _FIFTH]) for at in starts]
    steps = [after - before for before, after in pairwise(levels)]
    steady = min(steps) > 0 and min(steps) >= _PART * mean(steps)
    return steady and levels[-1] > highest
