"""What this host allows an emulation, and the cgroups that limit its computers."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from poise.emulate.emulated_network import NAMESPACES, find_tool
from poise.emulate.limits import Limits, Usage, starved_time
from poise.emulate.processes import marked, stop
from poise.kernel_counters import PREPARED, Mount, group_cpu, mounts, process_cpu, table


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
    """Makes groups without limits, where there are no cgroups. Nothing here blocks."""

    # which of ``cpu``, ``cpuset`` and ``memory`` its groups limit
    controls: frozenset[str] = frozenset()

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

    def make(self, name: str, limits: Limits) -> None:
        """Make a group; OSError when the kernel refuses."""
        homes = self.homes(name)
        for folder in homes.values():
            self.make_folder(folder)
        for file, value in self.settings(homes, limits):
            self.write(file, value)

    def make_folder(self, folder: Path) -> None:
        """Make the folder of a group if it does not exist."""
        folder.mkdir(exist_ok=True)

    def write(self, file: Path, value: object) -> None:
        """Write a file of a group; OSError when the kernel refuses."""
        file.write_text(f"{value}\n")


class Group:
    """The processes of an emulated computer; without cgroups, those marked."""

    def __init__(self, name: str, homes: Mapping[str, Path], cpus: int) -> None:
        self._name = name
        self._homes = homes
        self._cpus = cpus
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
        memory = (int(self._read("memory", name) or 0) for name in _MEMORY_PEAKS)
        return Usage(
            used=group_cpu(used) if used else 0.0,
            throttled=throttled,
            memory=next(filter(None, memory), None),
            starved=starved_time(
                self._read("pressure", "cpu.pressure"),
                throttled,
                self._cpus,
                self._read("pressure", f"{PREPARED}/cpu.pressure"),
            ),
        )

    def _read(self, controller: str, name: str) -> str:
        """Return the content of a file, or "" if the kernel does not provide it."""
        try:
            return (self._homes[controller] / name).read_text()
        except (KeyError, OSError):  # EOPNOTSUPP where pressure is switched off
            return ""


def _inner(folder: Path) -> Path:
    """Return where processes of a group are: it may have a folder for them."""
    programs = folder / PROGRAMS
    return programs if programs.is_dir() else folder


_SHARES = 262144
"""The kernel's maximum: other processes on the CPU hardly count."""
_REAL_TIME = 0.2
"""The share of each CPU that a group's real-time threads may use beside its quota. On
the robot these control threads would not wait for components either."""
_REAL_TIME_PERIOD = 0.1
"""The period of this share [s]."""


class V1(Groups):
    """Makes a group in each version 1 hierarchy that it may write to.

    A version 2 hierarchy is often mounted beside them, without controllers. Groups are
    made there too, because only there the kernel reports CPU pressure.
    """

    def __init__(self, mounts: Iterable[Mount]) -> None:
        self._bases: dict[str, Path] = {}
        for mount in mounts:
            wanted = mount.controllers & {"cpu", "cpuacct", "cpuset", "memory"}
            names = {"pressure"} if mount.version > 1 else wanted
            if os.access(mount.own, os.W_OK):
                self._bases |= dict.fromkeys(names, mount.own)
        self.controls = frozenset(self._bases) & {"cpu", "cpuset", "memory"}

    def homes(self, name: str) -> dict[str, Path]:
        """Return controller -> the folder of the group called `name`."""
        return {controller: base / name for controller, base in self._bases.items()}

    def make(self, name: str, limits: Limits) -> None:
        """Make a group, and allow real-time threads if the kernel limits them."""
        super().make(name, limits)
        file = self.homes(name).get("cpu", Path()) / "cpu.rt_runtime_us"
        if file.exists():
            period = round(_REAL_TIME_PERIOD * 1e6)
            with suppress(OSError):  # other groups use all of it
                self.write(file.with_name("cpu.rt_period_us"), period)
                self.write(file, round(_REAL_TIME * period))

    def settings(self, homes: Mapping[str, Path], limits: Limits) -> Settings:
        """Yield files of a group, and what they must contain."""
        if cpu := homes.get("cpu"):
            yield cpu / "cpu.cfs_period_us", limits.period_us
            yield cpu / "cpu.cfs_quota_us", limits.quota_us or -1
            yield cpu / "cpu.shares", _SHARES
        if cpuset := homes.get("cpuset"):
            mems = self._bases["cpuset"] / "cpuset.mems"
            yield cpuset / "cpuset.mems", mems.read_text().strip()
            yield cpuset / "cpuset.cpus", limits.cpu_list
        if (memory := homes.get("memory")) and limits.memory:
            yield memory / "memory.limit_in_bytes", limits.memory
            if (memory / "memory.memsw.limit_in_bytes").exists():
                yield memory / "memory.memsw.limit_in_bytes", limits.memory


_WEIGHT = 10000
"""The kernel's maximum: other processes on the CPU hardly count."""
_TRIES = 5
"""How often processes are moved aside, because they may start others meanwhile."""


class V2(Groups):
    """Makes groups below the topmost folder (root), or below its own (delegated)."""

    def __init__(self, mount: Mount) -> None:
        self._base = mount.top if os.access(mount.top, os.W_OK) else mount.own
        available = (self._base / "cgroup.controllers").read_text().split()
        self.controls = frozenset(available) & {"cpu", "cpuset", "memory"}

    def homes(self, name: str) -> dict[str, Path]:
        """Return controller -> the one folder of the group called `name`."""
        controllers = ("cpu", "cpuset", "memory", "pressure")
        return dict.fromkeys(controllers, self._base / name)

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return where `prepare` moves processes that are in the way."""
        return (self._base / f"{name}-aside",)

    def prepare(self, name: str) -> None:
        """Enable the controllers for the future groups."""
        control = self._base / "cgroup.subtree_control"
        missing = self.controls - set(control.read_text().split())
        if not missing:
            return
        for tries_left in reversed(range(_TRIES + 1)):
            try:
                self.write(control, " ".join(f"+{each}" for each in sorted(missing)))
            except OSError as error:
                if error.errno != errno.EBUSY or not tries_left:
                    raise
                self._put_aside(*self.aside(name))
            else:
                return

    def _put_aside(self, folder: Path) -> None:
        self.make_folder(folder)
        for pid in (self._base / "cgroup.procs").read_text().split():
            with suppress(ProcessLookupError):
                self.write(folder / "cgroup.procs", pid)

    def make(self, name: str, limits: Limits) -> None:
        """Make a group in which an agent may make others."""
        super().make(name, limits)
        folder = self._base / name
        if "cpu" in self.controls:
            self.write(folder / "cgroup.subtree_control", "+cpu")
            self.make_folder(folder / PROGRAMS)

    def settings(self, homes: Mapping[str, Path], limits: Limits) -> Settings:
        """Yield files of a group, and what they must contain."""
        folder = homes["cpu"]
        if "cpu" in self.controls:
            yield folder / "cpu.max", f"{limits.quota_us or 'max'} {limits.period_us}"
            yield folder / "cpu.weight", _WEIGHT
        if "cpuset" in self.controls:
            yield folder / "cpuset.cpus", limits.cpu_list
        if "memory" in self.controls and limits.memory:
            yield folder / "memory.max", limits.memory
            yield folder / "memory.swap.max", 0


_NAMES = {"cpu": "quota", "cpuset": "CPU set in a cgroup", "memory": "memory limit"}

_NEEDED = 1 << 12 | 1 << 21
_NOT_DELEGATED = (
    "this user may not write to a cgroup that controls it; become root, or use "
    "`systemd-run --user --scope -p Delegate=yes`"
)
_NOT_ROOT = (
    "namespaces and shaped links: only root may make them; become root, or root in a "
    "user namespace (docs/emulation.md)"
)


class Probe(Struct, frozen=True, kw_only=True):
    """The abilities of a host."""

    cpus: tuple[int, ...]  # the CPUs that this process may use; one at least
    groups: Groups  # how processes are grouped and limited
    # which of ``ip``, ``tc``, ``nsenter`` and ``taskset`` are installed
    tools: frozenset[str]
    may_make_namespaces: bool  # whether this process may make network namespaces

    def without_groups(self) -> list[str]:
        """Return which limits cgroups cannot set on this host, and why."""
        missing = [
            name for key, name in _NAMES.items() if key not in self.groups.controls
        ]
        return [f"{', '.join(missing)}: {_NOT_DELEGATED}"] if missing else []

    def without_network(self) -> list[str]:
        """Return why there can be no namespaces, or no shaped links."""
        if missing := sorted({"ip", "nsenter"} - self.tools):
            return [f"namespaces and shaped links: {', '.join(missing)} not installed"]
        if not self.may_make_namespaces:
            return [_NOT_ROOT]
        return [] if "tc" in self.tools else ["shaped links: tc is not installed"]

    @property
    def has_namespaces(self) -> bool:
        """Whether network namespaces can be made and entered."""
        return self.may_make_namespaces and {"ip", "nsenter"} <= self.tools


def probe_host() -> Probe:
    """Return the abilities of this host, without changing it."""
    return Probe(
        cpus=tuple(sorted(os.sched_getaffinity(0))),
        groups=_groups(mounts()),
        tools=frozenset(
            [
                *filter(find_tool, ("ip", "tc")),
                *filter(shutil.which, ("nsenter", "taskset")),
            ]
        ),
        may_make_namespaces=_may_administer() and os.access(NAMESPACES.parent, os.W_OK),
    )


def _groups(mounts: list[Mount]) -> Groups:
    if any(mount.version == 1 and "cpu" in mount.controllers for mount in mounts):
        first = V1(mounts)
        return first if first.controls else Groups()
    for mount in mounts:
        if mount.version > 1 and os.access(mount.own, os.W_OK):
            return V2(mount)
    return Groups()


def _may_administer() -> bool:
    """Return whether this process has CAP_NET_ADMIN and CAP_SYS_ADMIN."""
    status = Path("/proc/self/status").read_text()
    effective = int(status.partition("CapEff:")[2].split()[0], 16)
    return effective & _NEEDED == _NEEDED
