"""Cgroups version 1: one hierarchy for each controller, or for a few together."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from poise.cgroup_mounts import Mount
from poise.emulate.cgroup.files import Files
from poise.emulate.cgroup.groups import Group, Groups, Settings
from poise.emulate.limits import Limits

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

    def __init__(self, mounts: Iterable[Mount], files: Files | None = None) -> None:
        super().__init__(files)
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

    def make(self, name: str, limits: Limits) -> Group:
        """Make a group, and allow real-time threads if the kernel limits them.

        Otherwise all threads of the group share its quota.
        """
        group = super().make(name, limits)
        file = self.homes(name).get("cpu", Path()) / "cpu.rt_runtime_us"
        if file.exists():
            period = round(_REAL_TIME_PERIOD * 1e6)
            with suppress(OSError):  # other groups use all of it
                self._files.write(file.with_name("cpu.rt_period_us"), period)
                self._files.write(file, round(_REAL_TIME * period))
        return group

    def settings(self, homes: Mapping[str, Path], limits: Limits) -> Settings:
        """Yield files of a group, and what they must contain."""
        if cpu := homes.get("cpu"):
            yield cpu / "cpu.cfs_period_us", limits.period_us
            yield cpu / "cpu.cfs_quota_us", limits.quota_us or -1
            yield cpu / "cpu.shares", _SHARES
        if cpuset := homes.get("cpuset"):
            mems = self._files.read(self._bases["cpuset"] / "cpuset.mems")
            yield cpuset / "cpuset.mems", mems.strip()
            yield cpuset / "cpuset.cpus", limits.cpu_list
        if (memory := homes.get("memory")) and limits.memory:
            yield memory / "memory.limit_in_bytes", limits.memory
            if (memory / "memory.memsw.limit_in_bytes").exists():
                yield memory / "memory.memsw.limit_in_bytes", limits.memory
