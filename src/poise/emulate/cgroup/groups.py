"""All processes of an emulated computer as a group, with its limits."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from poise.emulate.cgroup.files import Files, pids, table
from poise.emulate.limits import Limits
from poise.emulate.processes import marked
from poise.emulate.usage import Usage, starved_time

Settings = Iterable[tuple[Path, object]]

_MEMORY_PEAKS = (
    "memory.max_usage_in_bytes",
    "memory.peak",
    "memory.current",  # kernels before 5.19 do not keep the peak
)


PROGRAMS = "programs"
"""The folder of a group of version 2 that has its processes: beside it, the computer's
agent makes groups for containers."""


class Groups:
    """Makes groups without limits, where there are no cgroups.

    `V1` and `V2` make groups with limits. Nothing here blocks.

    Attributes
    ----------
    controls
        Which of ``cpu``, ``cpuset`` and ``memory`` its groups limit.
    """

    controls: frozenset[str] = frozenset()

    def __init__(self, files: Files | None = None) -> None:
        self._files = files or Files()

    def homes(self, name: str) -> dict[str, Path]:
        """Return controller -> the folder of the group called `name`."""
        del name
        return {}

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return where `prepare` moves processes that are in the way."""
        del name
        return ()

    def prepare(self, name: str) -> None:
        """Prepare the first group of run `name`; OSError when the kernel refuses."""

    def settings(self, homes: Mapping[str, Path], limits: Limits) -> Settings:
        """Yield files of a group, and what they must contain."""
        del homes, limits
        return ()

    def make(self, name: str, limits: Limits) -> Group:
        """Make a group; OSError when the kernel refuses."""
        homes = self.homes(name)
        for folder in dict.fromkeys(homes.values()):
            self._files.make(folder)
        for file, value in self.settings(homes, limits):
            self._files.write(file, value)
        return Group(name, homes, len(limits.cpus), self._files)


class Group:
    """All processes of one emulated computer.

    Without cgroups they are those that inherited the group's name as a mark.

    Attributes
    ----------
    joins
        A process enters by writing its number into each of these files.
    cpu_file
        The file in which the kernel counts its CPU time; None: there is none.
    """

    def __init__(
        self, name: str, homes: Mapping[str, Path], cpus: int, files: Files
    ) -> None:
        self._name = name
        self._homes = homes
        self._cpus = cpus
        self._files = files
        folders = dict.fromkeys(homes.values())
        self._folders = tuple(folders)
        self.joins = tuple(_inner(folder) / "cgroup.procs" for folder in folders)
        files_of = (("cpuacct", "cpuacct.usage"), ("cpu", "cpu.stat"))
        counted = [homes[which] / file for which, file in files_of if which in homes]
        self.cpu_file = counted[0] if counted else None

    def processes(self) -> list[int]:
        """Return the numbers of the processes in it."""
        if not self.joins:
            return marked(self._name)
        return sorted({pid for folder in self._folders for pid in pids(folder)})

    def usage(self) -> Usage:
        """Return its usage since it was made."""
        if not self.joins:
            return Usage(used=sum(map(_cpu_time, self.processes())))
        # Version 1 counts in ns, version 2 in us.
        stat = table(self._read("cpu", "cpu.stat"))
        nanoseconds = int(self._read("cpuacct", "cpuacct.usage") or 0)
        throttled = (
            stat.get("throttled_usec", 0) / 1e6 + stat.get("throttled_time", 0) / 1e9
        )
        pressure = self._read("pressure", "cpu.pressure")
        memory = (int(self._read("memory", name) or 0) for name in _MEMORY_PEAKS)
        return Usage(
            used=stat.get("usage_usec", 0) / 1e6 + nanoseconds / 1e9,
            throttled=throttled,
            memory=next(filter(None, memory), None),
            starved=starved_time(pressure, throttled, self._cpus) if pressure else None,
        )

    def _read(self, controller: str, name: str) -> str:
        """Return the content of a file, or "" if the kernel does not provide it."""
        try:
            return self._files.read(self._homes[controller] / name)
        except (KeyError, OSError):  # EOPNOTSUPP where pressure is switched off
            return ""


def _inner(folder: Path) -> Path:
    """Return where processes of a group are: it may have a folder for them."""
    programs = folder / PROGRAMS
    return programs if programs.is_dir() else folder


def _cpu_time(pid: int) -> float:
    """Return the CPU time of a process that still runs [s]."""
    with suppress(OSError):  # it has ended
        # Linux's name for "the CPU-time clock of process pid".
        return time.clock_gettime((~pid << 3) | 2)
    return 0.0
