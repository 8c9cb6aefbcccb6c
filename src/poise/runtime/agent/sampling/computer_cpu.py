"""The CPU time of all programs of this computer, also of others than Poise."""

from __future__ import annotations

import os
from pathlib import Path

from poise.runtime.agent.sampling.kernel_file import KernelFile

CPU_FILE = "POISE_CPU_FILE"
"""Environment variable of an emulated computer: its cgroup's CPU time; empty: nobody
counts it. Not set on a real computer, where the kernel counts all."""

_TICK = 1 / os.sysconf("SC_CLK_TCK")
_BUSY = (1, 2, 3, 6, 7)
"""Of a CPU's times in /proc/stat: user, nice, system, and those of interrupts."""


class ComputerCpu:
    """Reads the CPU time of all programs of this computer."""

    def __init__(self) -> None:
        path = os.environ.get(CPU_FILE)
        self._is_group = path is not None
        self._file = KernelFile(Path(path or "/proc/stat")) if path != "" else None

    def read(self) -> float | None:
        """Return the CPU time so far [s].

        None when nobody counts it: on an emulated computer without a cgroup.
        """
        if self._file is None:
            return None
        try:
            text = self._file.read()
            return _of_group(text) if self._is_group else _of_all(text)
        except (OSError, ValueError, IndexError):
            return None


def _of_all(stat: str) -> float:
    times = stat.partition("\n")[0].split()
    return sum(int(times[i]) for i in _BUSY) * _TICK


def _of_group(usage: str) -> float:
    """Return what a cgroup used: version 1 counts in ns, version 2 in us."""
    if usage.startswith("usage_usec "):
        return int(usage.split()[1]) / 1e6
    return int(usage) / 1e9
