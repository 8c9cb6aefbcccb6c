"""How much of a budget is left, where other programs want the CPU, too."""

from __future__ import annotations

from time import perf_counter, thread_time

BUSY = 4.0
"""On a busy machine a budget lasts this many times as long at most; `Stop` of the core
(`plan/core/problem/stop.h`) has the same number."""


class Budget:
    """What this thread may spend from now on [s of a CPU]."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._began, self._cpu = perf_counter(), thread_time()

    def left(self) -> float:
        """Return what is left [s]; below 0 when it is over."""
        waited = (perf_counter() - self._began) / BUSY
        return self._seconds - max(thread_time() - self._cpu, waited)
