"""How much memory the programs of this computer may still take."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from poise.cgroup_mounts import NO_LIMIT, memory_group

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
    """Reads the limits that hold for this process and its children.

    Parameters
    ----------
    proc
        Where the kernel's process files are.
    """

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
