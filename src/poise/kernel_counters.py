"""What the kernel counts: CPU time, memory and waiting, in /proc and in cgroups."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from mmap import PAGESIZE
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct

CPU_GROUP = "POISE_CPU_GROUP"
"""Environment variable of an emulated computer: the folder of its CPU cgroup, for
groups in it; empty: there is none. Not set on a real computer."""
PRESSURE_GROUP = "POISE_PRESSURE_GROUP"
"""Environment variable of an emulated computer: its cgroup in another hierarchy, which
reports pressure; empty: there is none. Not set on a real computer."""
PREPARED = "prepared"
"""The group that an agent makes for containers that get only the CPU that others leave;
with version 1, it makes one where the kernel reports pressure, too."""
NO_LIMIT = 1 << 60
"""A memory limit from this on is none [bytes]."""


class Mount(Struct, frozen=True):
    """A mounted cgroup hierarchy, and the folder in it that this process is in."""

    version: int
    top: Path
    own: Path
    controllers: frozenset[str]

    @property
    def groups(self) -> Sequence[Path]:
        """The groups whose limits hold: that of this process, and those above."""
        above = [p for p in self.own.parents if p.is_relative_to(self.top)]
        return (self.own, *above)


def mounts(
    mountinfo: Path = Path("/proc/self/mountinfo"),
    cgroup: Path = Path("/proc/self/cgroup"),
) -> list[Mount]:
    """Return the cgroup hierarchies that are mounted, as proc(5) describes them."""
    entries = [line.split(":", 2) for line in cgroup.read_text().splitlines()]
    paths = {frozenset(names.split(",")): path for _, names, path in entries}
    found = []
    for line in mountinfo.read_text().splitlines():
        before, _, after = line.partition(" - ")
        kind, _, options = after.split(" ", 2)
        root, top = before.split()[3], Path(before.split()[4])
        if kind == "cgroup2":
            own = _below(top, root, paths.get(frozenset([""]), "/"))
            names = _words(own / "cgroup.controllers")
            found.append(Mount(2, top, own, names))
        elif kind == "cgroup":
            names = frozenset(options.split(","))
            mine = next((path for key, path in paths.items() if key <= names), "/")
            found.append(Mount(1, top, _below(top, root, mine), names))
    return found


def memory_group(proc: Path = Path("/proc")) -> Mount | None:
    """Return the hierarchy that counts this process's memory; None: none does."""
    found: list[Mount] = []
    with contextlib.suppress(OSError):
        found = mounts(proc / "self/mountinfo", proc / "self/cgroup")
    files = ("memory.events", "memory.oom_control")
    return next((m for m in found if any((m.own / f).exists() for f in files)), None)


def _below(top: Path, root: str, path: str) -> Path:
    own = top / path.removeprefix(root).lstrip("/")
    # In a container, the path may be the host's and mean nothing here.
    return own if own.is_dir() else top


def _words(file: Path) -> frozenset[str]:
    return frozenset(file.read_text().split()) if file.exists() else frozenset()


CPU_FILE = "POISE_CPU_FILE"
"""Environment variable of an emulated computer: its cgroup's CPU time; empty: nobody
counts it. Not set on a real computer, where the kernel counts all."""

_TICK = 1 / os.sysconf("SC_CLK_TCK")
_BUSY = (1, 2, 3, 6, 7)
"""Of a CPU's times in /proc/stat: user, nice, system, and those of interrupts."""
_STOLEN = 8


class ComputerCpu:
    """Reads the CPU time of all programs of this computer."""

    def __init__(self) -> None:
        path = os.environ.get(CPU_FILE)
        self._is_group = path is not None
        self._file = Path(path or "/proc/stat") if path != "" else None

    def read(self) -> float | None:
        """Return the CPU time so far [s]; None: the kernel does not count it."""
        if self._file is None:
            return None
        try:
            text = self._file.read_text()
            return group_cpu(text) if self._is_group else _of_all(text)
        except (OSError, ValueError, LookupError):
            return None


def _of_all(stat: str) -> float:
    times = stat.partition("\n")[0].split()
    return sum(int(times[i]) for i in _BUSY) * _TICK


def group_cpu(usage: str) -> float:
    """Return the CPU time in a cgroup's file [s]: version 1 has ns, version 2 us."""
    counts = table(usage)
    return counts.get("usage_usec", 0) / 1e6 if counts else int(usage) / 1e9


def stolen_time(cpus: Iterable[int]) -> float:
    """Return the time that a hypervisor stole from `cpus` since boot [s].

    Pressure does not include it: to this kernel, stolen time looks like running.
    """
    names = {f"cpu{number}" for number in cpus}
    lines = map(str.split, Path("/proc/stat").read_text().splitlines())
    return sum(int(line[_STOLEN]) for line in lines if line[0] in names) * _TICK


class ProcessStat(NamedTuple):
    """What `/proc` says of a process or a thread."""

    state: str  # a letter, as ps(1) has it
    parent: int
    started: int  # since the computer started [ticks]

    @property
    def is_stopped(self) -> bool:
        """Whether a signal or a debugger stopped it."""
        return self.state in {"T", "t"}


def stat_of(folder: Path) -> ProcessStat | None:
    """Return what a folder of `/proc` says; None: its process has ended."""
    try:
        text = (folder / "stat").read_text()
    except OSError:
        return None
    # the program's name, in brackets, may hold blanks and brackets
    fields = text.rpartition(")")[2].split()
    return ProcessStat(fields[0], int(fields[1]), int(fields[19]))


def process_stat(pid: int) -> ProcessStat | None:
    """Return what is known of a process; None: it has ended."""
    return stat_of(Path(f"/proc/{pid}"))


def process_cpu(pid: int) -> float:
    """Return the CPU time of a process so far [s]; 0 when it has ended."""
    try:
        return time.clock_gettime(~pid * 8 | 2)  # CPUCLOCK_SCHED of a process
    except OSError:
        return 0.0


class Processes:
    """What the kernel knows of processes."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc

    def is_stopped(self, pid: int) -> bool:
        """Return whether a process was stopped by a signal or a debugger."""
        found = stat_of(self._proc / str(pid))
        return found is not None and found.is_stopped

    def tracer(self, pid: int) -> int:
        """Return the process that debugs a process; 0: none does."""
        with contextlib.suppress(OSError, ValueError, KeyError):
            text = (self._proc / str(pid) / "status").read_text()
            fields = dict(line.partition(":")[::2] for line in text.splitlines())
            return int(fields["TracerPid"])
        return 0

    def has_ended(self, pid: int) -> bool:
        """Return whether a process has ended, also if its parent has not asked yet."""
        found = stat_of(self._proc / str(pid))
        return found is None or found.state == "Z"

    def has_one_that_goes_on(self, pid: int) -> bool:
        """Return whether a thread is runnable, or waits for a disk or for memory."""
        threads = map(stat_of, (self._proc / str(pid) / "task").glob("*"))
        return any(thread and thread.state in {"R", "D"} for thread in threads)

    def cpu(self, pid: int) -> float:
        """Return the CPU time of a process so far [s]; 0 when it has ended."""
        return process_cpu(pid)

    def delays(self, pid: int) -> dict[int, float]:
        """Return each thread's time runnable without a CPU [s]; empty: not counted."""
        delays = {}
        for thread in (self._proc / str(pid) / "task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # it has ended
                waited = int(thread.read_text().split()[1])
                delays[int(thread.parent.name)] = waited * 1e-9
        return delays


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
    """Return a process's proportional set size [bytes]; 0: it is not known."""
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
        self._groups = mount.groups if mount is not None else ()

    def read(self) -> MemoryRoom | None:
        """Return the nearest limit; None when nothing is known."""
        return min(self._rooms(), key=lambda room: room.free, default=None)

    def size(self) -> int:
        """Return the least of the limits [bytes]; 0 when none is known."""
        return int(min((room.limit for room in self._rooms()), default=0.0))

    def _rooms(self) -> Iterator[MemoryRoom]:
        with contextlib.suppress(OSError, ValueError, KeyError):
            amounts = table(self._meminfo.read_text())
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
                    cached = table((group / "memory.stat").read_text()).get(cache, 0)
                    yield MemoryRoom(limit, max(0.0, limit - used + cached))


def cores_of_computer(proc: Path = Path("/proc")) -> float:
    """Return how many cores this process may use: its CPUs, and its cgroups' quotas."""
    found = [float(len(os.sched_getaffinity(0)))]
    with contextlib.suppress(OSError):
        for mount in mounts(proc / "self/mountinfo", proc / "self/cgroup"):
            found += map(_quota, mount.groups)
    return min(found)


def _quota(group: Path) -> float:
    """Return how many cores a cgroup may use; endless: all."""
    with contextlib.suppress(OSError, ValueError):
        quota, period = (group / "cpu.max").read_text().split()
        return int(quota) / int(period)  # "max" is no number
    with contextlib.suppress(OSError, ValueError):
        quota = (group / "cpu.cfs_quota_us").read_text()
        period = (group / "cpu.cfs_period_us").read_text()
        if int(quota) > 0:  # -1: there is none
            return int(quota) / int(period)
    return math.inf


def table(text: str) -> dict[str, int]:
    """Return the numbers of a text with a name and a number in each line."""
    lines = (line.split() for line in text.splitlines())
    return {line[0]: int(line[1]) for line in lines if len(line) > 1}
