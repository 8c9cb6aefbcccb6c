"""Tells whether the kernel killed a process of this computer for lack of memory.

The kernel counts such kills per cgroup (``memory.oom_control`` of version 1,
``memory.events`` of version 2), and in ``/proc/vmstat`` for the whole machine.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

from poise.cgroup_mounts import NO_LIMIT, memory_group
from poise.units import format_bytes

_LATE = 10.0
"""The end of a killed process is known within this time after the kill [s]."""


class OomKills:
    """The kills of this process's cgroup, each of which explains one end.

    Parameters
    ----------
    proc
        Where the kernel's process files are.
    """

    def __init__(self, proc: Path = Path("/proc")) -> None:
        mount = memory_group(proc)
        group = mount.own if mount is not None else Path("/nonexistent")
        counters = [
            group / "memory.events",
            group / "memory.oom_control",
            proc / "vmstat",
        ]
        self._file = next((f for f in counters if _count(f) is not None), None)
        self._limits = group / "memory.max", group / "memory.limit_in_bytes"
        self._seen = (_count(self._file) or 0) if self._file else 0
        self._unclaimed: deque[float] = deque()

    def look(self, now: float) -> None:
        """Take note of kills until `now` [s]; call it a few times a second."""
        count = _count(self._file) if self._file else None
        if count is None:  # no file descriptor is free at the moment
            count = self._seen
        self._unclaimed.extend([now] * (count - self._seen))
        self._seen = count
        while self._unclaimed and self._unclaimed[0] < now - _LATE:
            self._unclaimed.popleft()

    def claim(self, now: float) -> bool:
        """Return whether a kill explains an end at `now` [s]; it explains no other."""
        self.look(now)
        if not self._unclaimed:
            return False
        self._unclaimed.popleft()
        return True

    def limit(self) -> str:
        """Return the memory limit of this computer in words; empty: none is known."""
        for file in self._limits:
            try:
                limit = int(file.read_text())
            except (OSError, ValueError):
                continue
            return f" (limit {format_bytes(limit)})" if limit < NO_LIMIT else ""
        return ""


def _count(file: Path) -> int | None:
    try:
        lines = file.read_text().splitlines()
    except OSError:
        return None
    counts = (line.split()[1] for line in lines if line.startswith("oom_kill "))
    return next(map(int, counts), None)
