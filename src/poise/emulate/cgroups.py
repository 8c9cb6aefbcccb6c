"""All processes of an emulated computer as a group, with its limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from poise.emulate.limits import Limits, Usage, starved_time
from poise.emulate.processes import marked, stop
from poise.kernel_counters import group_cpu, process_cpu, table


class Files:
    """Operations on cgroup files; tests replace it by a fake kernel."""

    def make(self, folder: Path) -> None:
        """Make a cgroup if it does not exist."""
        folder.mkdir(exist_ok=True)

    def write(self, file: Path, value: object) -> None:
        """Write `value` to `file`; OSError when the kernel refuses."""
        file.write_text(f"{value}\n")

    def read(self, file: Path) -> str:
        """Return the content of `file`."""
        return file.read_text()


def pids(folder: Path) -> list[int]:
    """Return the processes in a cgroup and in those below; none if it is not there."""
    pids = []
    for file in [folder / "cgroup.procs", *folder.glob("*/cgroup.procs")]:
        with suppress(OSError):
            pids += [int(pid) for pid in file.read_text().split()]
    return pids


def lift(folder: str) -> None:
    """Lift a cgroup's quota: even a killed process needs CPU to end."""
    for name, value in (("cpu.cfs_quota_us", "-1"), ("cpu.max", "max")):
        with suppress(FileNotFoundError), Path(folder, name).open("r+") as file:
            file.write(value)


def remove(path: str) -> None:
    """End every process in a cgroup and remove it, if it exists."""
    lift(path)
    folder = Path(path)
    stop(lambda: pids(folder), ask=0.0)
    with suppress(FileNotFoundError):
        for inner in folder.iterdir():
            if inner.is_dir():
                inner.rmdir()
        folder.rmdir()


def bring_back(path: str) -> None:
    """Move processes from a cgroup back to the one above; remove it."""
    folder = Path(path)
    if not folder.exists():
        return
    control = folder.parent / "cgroup.subtree_control"
    off = [f"-{controller}" for controller in control.read_text().split()]
    control.write_text(" ".join(off))
    for pid in pids(folder):
        with suppress(ProcessLookupError):
            (folder.parent / "cgroup.procs").write_text(str(pid))
    folder.rmdir()


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
    """

    # which of ``cpu``, ``cpuset`` and ``memory`` its groups limit
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
            return Usage(used=sum(map(process_cpu, self.processes())))
        stat = table(self._read("cpu", "cpu.stat"))
        used = self._read("cpuacct", "cpuacct.usage") or self._read("cpu", "cpu.stat")
        throttled = (
            stat.get("throttled_usec", 0) / 1e6 + stat.get("throttled_time", 0) / 1e9
        )
        pressure = self._read("pressure", "cpu.pressure")
        memory = (int(self._read("memory", name) or 0) for name in _MEMORY_PEAKS)
        return Usage(
            used=group_cpu(used) if used else 0.0,
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
