"""Cgroups version 2: one hierarchy, in which controllers are enabled folder by folder.

Two rules of the kernel shape this file. A folder gives its children only the
controllers in its ``cgroup.subtree_control``. And such a folder (except the topmost)
may not contain processes, so its processes, including this one, move aside into a child
folder until the run ends.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from poise.emulate.cgroup.files import Files, Mount, pids, table
from poise.emulate.limits import Limits
from poise.emulate.usage import Usage, starved_time

_WEIGHT = 10000
"""The kernel's maximum: other processes on the CPU hardly count."""
_TRIES = 5
"""How often processes are moved aside, because they may start others meanwhile."""


class V2:
    """Makes groups below the topmost folder (root), or below its own (delegated)."""

    def __init__(self, mount: Mount, files: Files | None = None) -> None:
        self._files = files or Files()
        self._base = mount.top if os.access(mount.top, os.W_OK) else mount.own
        available = self._files.read(self._base / "cgroup.controllers").split()
        self.controls = frozenset(available) & {"cpu", "cpuset", "memory"}

    def folders(self, name: str) -> tuple[Path, ...]:
        """Return the group's one folder."""
        return (self._base / name,)

    def aside(self, name: str) -> tuple[Path, ...]:
        """Return where `prepare` moves processes that are in the way."""
        return (self._base / f"{name}-aside",)

    def prepare(self, name: str) -> None:
        """Enable the controllers for the future groups.

        Raises
        ------
        OSError
            The kernel refuses, for instance because another user's processes are in the
            way.
        """
        control = self._base / "cgroup.subtree_control"
        missing = self.controls - set(self._files.read(control).split())
        enable = " ".join(f"+{controller}" for controller in sorted(missing))
        for _ in range(_TRIES) if missing else ():
            try:
                self._files.write(control, enable)
            except OSError as error:
                if error.errno != errno.EBUSY:
                    raise
                self._put_aside(*self.aside(name))
            else:
                return
        if missing:
            self._files.write(control, enable)

    def make(self, name: str, limits: Limits) -> V2Group:
        """Make the group `name`."""
        (folder,) = self.folders(name)
        self._files.make(folder)
        for file, value in self._settings(limits):
            self._files.write(folder / file, value)
        return V2Group(folder, len(limits.cpus), self._files)

    def _put_aside(self, folder: Path) -> None:
        self._files.make(folder)
        for pid in self._files.read(self._base / "cgroup.procs").split():
            with suppress(ProcessLookupError):
                self._files.write(folder / "cgroup.procs", pid)

    def _settings(self, limits: Limits) -> Iterable[tuple[str, object]]:
        if "cpu" in self.controls:
            # A quota that fills its CPUs needs no throttling.
            throttles = limits.quota < len(limits.cpus)
            period = round(limits.period * 1e6)
            quota = round(limits.quota * period) if throttles else "max"
            yield "cpu.max", f"{quota} {period}"
            yield "cpu.weight", _WEIGHT
        if "cpuset" in self.controls:
            yield "cpuset.cpus", ",".join(map(str, limits.cpus))
        if "memory" in self.controls and limits.memory:
            yield "memory.max", limits.memory
            yield "memory.swap.max", 0


class V2Group:
    """One emulated computer's group."""

    def __init__(self, folder: Path, cpus: int, files: Files) -> None:
        self._folder = folder
        self._cpus = cpus
        self._files = files
        self.joins: tuple[Path, ...] = (folder / "cgroup.procs",)

    def processes(self) -> list[int]:
        """Return the numbers of the processes in it."""
        return pids(self._folder)

    def usage(self) -> Usage:
        """Return its usage since it was made."""
        stat = table(self._read("cpu.stat"))
        throttled = stat.get("throttled_usec", 0) / 1e6
        pressure = self._read("cpu.pressure")
        # Kernels before 5.19 do not keep the peak.
        memory = self._read("memory.peak") or self._read("memory.current")
        return Usage(
            used=stat.get("usage_usec", 0) / 1e6,
            throttled=throttled,
            memory=int(memory) if memory else None,
            starved=starved_time(pressure, throttled, self._cpus) if pressure else None,
        )

    def _read(self, name: str) -> str:
        """Return the content of a file, or "" if the kernel does not provide it."""
        try:
            return self._files.read(self._folder / name)
        except OSError:  # ENOENT, or EOPNOTSUPP where pressure is switched off
            return ""
