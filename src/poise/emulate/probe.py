"""Finds out what this host allows an emulation to do."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from msgspec import Struct

from poise.cgroup_mounts import Mount, mounts
from poise.emulate.cgroup.groups import Groups
from poise.emulate.cgroup.versions import V1, V2
from poise.emulate.emulated_network import NAMESPACES

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


def look() -> Probe:
    """Return the abilities of this host, without changing it."""
    return Probe(
        cpus=tuple(sorted(os.sched_getaffinity(0))),
        groups=_groups(mounts()),
        tools=frozenset(filter(shutil.which, ("ip", "tc", "nsenter", "taskset"))),
        may_make_namespaces=_may_administer() and os.access(NAMESPACES.parent, os.W_OK),
    )


def _groups(found: list[Mount]) -> Groups:
    if any(mount.version == 1 and "cpu" in mount.controllers for mount in found):
        first = V1(found)
        return first if first.controls else Groups()
    for mount in found:
        if mount.version > 1 and os.access(mount.own, os.W_OK):
            return V2(mount)
    return Groups()


def _may_administer() -> bool:
    """Return whether this process has CAP_NET_ADMIN and CAP_SYS_ADMIN.

    Root in a container often has neither.
    """
    status = Path("/proc/self/status").read_text()
    effective = int(status.partition("CapEff:")[2].split()[0], 16)
    return effective & _NEEDED == _NEEDED
