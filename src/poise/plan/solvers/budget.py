"""How much of a budget is left, where other programs want the CPU, too."""

from __future__ import annotations

from time import perf_counter, thread_time

BUSY = 4.0
"""A budget of CPU time takes at most so many times as long on a busy machine; the same
in `plan/core/problem/stop.h`."""


class Budget:
    """What this thread may spend from now on [s of a CPU]."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._began, self._cpu = perf_counter(), thread_time()

    def left(self) -> float:
        """Return what is left [s]; below 0 when it is over."""
        waited = (perf_counter() - self._began) / BUSY
        return self._seconds - max(thread_time() - self._cpu, waited)
