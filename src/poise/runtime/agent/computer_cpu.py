"""The CPU time of all programs of this computer, also of others than Poise."""

from __future__ import annotations

import os
from pathlib import Path

CPU_FILE = "POISE_CPU_FILE"
"""Environment variable of an emulated computer: its cgroup's CPU time; empty: nobody
counts it. Not set on a real computer, where the kernel counts all."""

_TICK = 1 / os.sysconf("SC_CLK_TCK")
_BUSY = (1, 2, 3, 6, 7)
"""Of a CPU's times in /proc/stat: user, nice, system, and those of interrupts."""


def computer_cpu() -> float | None:
    """Return the CPU time of all programs of this computer so far [s].

    None when nobody counts it: on an emulated computer without a cgroup.
    """
    file = os.environ.get(CPU_FILE)
    try:
        if file is None:
            return _of_all(Path("/proc/stat").read_text(encoding="ascii"))
        return _of_group(Path(file)) if file else None
    except (OSError, ValueError, IndexError):
        return None


def _of_all(stat: str) -> float:
    times = stat.partition("\n")[0].split()
    return sum(int(times[i]) for i in _BUSY) * _TICK


def _of_group(file: Path) -> float:
    """Return what a cgroup used: version 1 counts in ns, version 2 in us."""
    text = file.read_text(encoding="ascii")
    if text.startswith("usage_usec "):
        return int(text.split()[1]) / 1e6
    return int(text) / 1e9
