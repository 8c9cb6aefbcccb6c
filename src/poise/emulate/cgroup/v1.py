"""Cgroups version 1: one hierarchy for each controller, or for a few together."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from poise.emulate.cgroup.files import Files, Mount, pids, table
from poise.emulate.limits import Limits
from poise.emulate.usage import Usage, starved_time

_SHARES = 262144
"""The kernel's maximum: other processes on the CPU hardly count."""
_REAL_TIME = 0.2
"""The share of each CPU that a group's real-time threads may use beside its quota. On
the robot these control threads would not wait for components either."""
_REAL_TIME_PERIOD = 0.1
"""The period of this share [s]."""


class V1:
    """Makes a group in each version 1 hierarchy that it may write to.

    A version 2 hierarchy is often mounted beside them, without controllers. Groups are
    made there too, because only there the kernel reports CPU pressure.
    """

    def __init__(self, mounts: Iterable[Mount], files: Files | None = None) -> None:
        self._files = files or Files()
        self._bases: dict[str, Path] = {}
        for mount in mounts:
            wanted = mount.controllers & {"cpu", "cpuacct", "cpuset", "memory"}
            names = {"pressure"} if mount.version > 1 else wanted
            if os.access(mount.own, os.W_OK):
                self._bases |= dict.fromkeys(names, mount.own)
        self.controls = frozenset(self._bases) & {"cpu", "cpuset", "memory"}

    def folders(self, name: str) -> tuple[Path, ...]:
        """Return the group's folder in each hierarchy, each once."""
        return tuple(dict.fromkeys(base / name for base in self._bases.values()))

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return none: in version 1 processes and groups may share a folder."""
        del name
        return ()

    def prepare(self, name: str) -> None:
        """Do nothing."""

    def make(self, name: str, limits: Limits) -> V1Group:
        """Make the group `name`."""
        for folder in self.folders(name):
            self._files.make(folder)
        homes = {which: base / name for which, base in self._bases.items()}
        for file, value in self._settings(homes, limits):
            self._files.write(file, value)
        self._allow_real_time(homes.get("cpu", Path()))
        return V1Group(homes, len(limits.cpus), self._files)

    def _allow_real_time(self, cpu: Path) -> None:
        """Allow real-time threads in a group, if the kernel limits them.

        Otherwise all threads of the group share its quota.
        """
        file = cpu / "cpu.rt_runtime_us"
        if file.exists():
            period = round(_REAL_TIME_PERIOD * 1e6)
            with suppress(OSError):  # other groups use all of it
                self._files.write(file.with_name("cpu.rt_period_us"), period)
                self._files.write(file, round(_REAL_TIME * period))

    def _settings(
        self, homes: Mapping[str, Path], limits: Limits
    ) -> Iterable[tuple[Path, object]]:
        if cpu := homes.get("cpu"):
            # A quota that fills its CPUs needs no throttling.
            throttles = limits.quota < len(limits.cpus)
            period = round(limits.period * 1e6)
            yield cpu / "cpu.cfs_period_us", period
            quota = round(limits.quota * period) if throttles else -1
            yield cpu / "cpu.cfs_quota_us", quota
            yield cpu / "cpu.shares", _SHARES
        if cpuset := homes.get("cpuset"):
            mems = self._files.read(self._bases["cpuset"] / "cpuset.mems")
            yield cpuset / "cpuset.mems", mems.strip()
            yield cpuset / "cpuset.cpus", ",".join(map(str, limits.cpus))
        if (memory := homes.get("memory")) and limits.memory:
            yield memory / "memory.limit_in_bytes", limits.memory
            if (memory / "memory.memsw.limit_in_bytes").exists():
                yield memory / "memory.memsw.limit_in_bytes", limits.memory


class V1Group:
    """One emulated computer's group."""

    def __init__(self, homes: Mapping[str, Path], cpus: int, files: Files) -> None:
        self._homes = homes
        self._cpus = cpus
        self._files = files
        folders = dict.fromkeys(homes.values())
        self.joins: tuple[Path, ...] = tuple(
            folder / "cgroup.procs" for folder in folders
        )

    def processes(self) -> list[int]:
        """Return the numbers of the processes in it."""
        return sorted({pid for file in self.joins for pid in pids(file.parent)})

    def usage(self) -> Usage:
        """Return its usage since it was made."""
        stat = table(self._read("cpu", "cpu.stat"))
        throttled = stat.get("throttled_time", 0) / 1e9
        pressure = self._read("pressure", "cpu.pressure")
        return Usage(
            used=int(self._read("cpuacct", "cpuacct.usage") or 0) / 1e9,
            throttled=throttled,
            memory=int(self._read("memory", "memory.max_usage_in_bytes") or 0) or None,
            starved=starved_time(pressure, throttled, self._cpus) if pressure else None,
        )

    def _read(self, which: str, name: str) -> str:
        """Return the content of a file, or "" if it does not exist."""
        file = self._homes.get(which, Path()) / name
        return self._files.read(file) if which in self._homes and file.exists() else ""
