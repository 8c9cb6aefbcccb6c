"""How the containers of a computer share its CPU when that is not enough for all.

Each is in a cgroup with the weight of its architecture's priority, where the agent may
make groups (emulated, or delegated by systemd's ``Delegate=cpu``); elsewhere it has a
nice value. What is prepared for a later action shares one group of limited CPU.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterable
from pathlib import Path

from poise.cgroup_mounts import mounts
from poise.priority import REAL_TIME
from poise.wire.records.deployment_records import ContainerSpec

log = logging.getLogger(__name__)

CPU_GROUP = "POISE_CPU_GROUP"
"""Environment variable of an emulated computer: the folder of its CPU cgroup; empty:
there is none. Not set on a real computer."""
_MOST = 10_000
"""The highest weight that the kernel takes: the agent's own."""
_SHARES = 10.24
"""Shares of version 1 for a weight of 1 of version 2."""
_LEAST_QUOTA = 0.001
"""The kernel counts quotas from this on [s]."""
_PERIOD = 0.02
"""What a quota is counted over, or longer where it would be too small [s]."""


class CpuWeights:
    """Gives containers their weights; for the agent's own thread."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.means = ""

    def nice_of(self, spec: ContainerSpec) -> int:
        """Return the nice value with which a container is to begin."""
        if spec.weight and not self.means:
            self.means = self._prepared()
        return spec.nice if self.means == "nice" else 0

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Put a container that began, or goes to work, into its group."""
        if not spec.weight or self._folder is None or self.means == "nice":
            return
        group = self._folder / ("prepared" if spec.spare else f"container-{spec.name}")
        try:
            group.mkdir(exist_ok=True)
            if spec.spare:
                _hold_back(group, spec.spare)
            else:
                _weigh(group, spec.weight)
            _enter(group, [pid])
        except OSError as error:
            log.warning("container '%s' shares the CPU as any: %s", spec.name, error)

    def forget(self, name: str) -> None:
        """Remove the group of a container that ended."""
        if self._folder is not None and self.means:
            # what is not empty yet is used again, or ends with the computer
            with contextlib.suppress(OSError):
                (self._folder / f"container-{name}").rmdir()

    def _prepared(self) -> str:
        """Return what can be used; with groups, the agent is in one itself then."""
        if self._folder is None or self._would_lose_real_time():
            return "nice"
        try:
            return self._use_groups(self._folder)
        except OSError as error:
            log.info("containers get nice values, not cgroups: %s", error)
            return "nice"

    def _would_lose_real_time(self) -> bool:
        """Whether real-time threads may not enter groups: so it is with version 1."""
        is_wanted = os.environ.get(REAL_TIME) == "1"
        return is_wanted and (Path(self._folder or "") / "cpu.rt_runtime_us").exists()

    @staticmethod
    def _use_groups(folder: Path) -> str:
        control, agent = folder / "cgroup.subtree_control", folder / "agent"
        agent.mkdir(exist_ok=True)
        _enter(agent, [os.getpid()])
        version = 1
        if control.exists():
            version = 2
            # who hands controllers on has no processes itself
            _enter(agent, map(int, (folder / "cgroup.procs").read_text().split()))
            control.write_text("+cpu")
        _weigh(agent, _MOST)
        return f"cgroup v{version}"


def own_group() -> Path | None:
    """Return the folder of the CPU cgroup in which this process may make others."""
    folder = os.environ.get(CPU_GROUP)
    if folder is not None:
        return Path(folder) if folder else None
    for mount in mounts():
        found = mount.own
        if found == mount.top or "cpu" not in mount.controllers:
            continue
        if found.name == "agent":  # of an agent before, or systemd's DelegateSubgroup
            found = found.parent
        if os.access(found / "cgroup.procs", os.W_OK):
            return found
    return None


def _enter(group: Path, pids: Iterable[int]) -> None:
    """Move processes with all their threads into a group; one that ended is none."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            (group / "cgroup.procs").write_text(str(pid))


def _weigh(group: Path, weight: int) -> None:
    shares = group / "cpu.shares"
    if shares.exists():
        shares.write_text(str(round(weight * _SHARES)))
    else:
        (group / "cpu.weight").write_text(str(weight))


def _hold_back(group: Path, cores: float) -> None:
    """Let a group have the CPU when nobody else wants it, and at most some cores."""
    period = max(_PERIOD, _LEAST_QUOTA / cores)
    quota_us, period_us = round(cores * period * 1e6), round(period * 1e6)
    if (group / "cpu.shares").exists():
        (group / "cpu.cfs_period_us").write_text(str(period_us))
        (group / "cpu.cfs_quota_us").write_text(str(quota_us))
    else:
        (group / "cpu.max").write_text(f"{quota_us} {period_us}")
    if (idle := group / "cpu.idle").exists():  # Linux 5.15
        idle.write_text("1")
    else:
        _weigh(group, 1)
