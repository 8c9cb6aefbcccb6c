"""The clock by which simulated components date their data: all computers agree."""

from __future__ import annotations

from poise.clock import Elapsed, Stamp
from poise.simulation.schedule.scheduler import Scheduler


class SimulatedClock:
    """Virtual time, as `poise.clock.ComponentClock`."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def now(self) -> float:
        """Return the time since the run began [s]."""
        return self._scheduler.now

    def sleep(self, seconds: float) -> None:
        """Let the task that runs wait [s]."""
        self._scheduler.wait(seconds, "sleep")

    def stamp(self, at: float | None = None) -> Stamp:
        """Return the present moment, or `at` [s]."""
        return Stamp(self.now() if at is None else at)

    def since(self, stamp: Stamp) -> Elapsed:
        """Return how long ago a moment was."""
        return Elapsed(self.now() - stamp.at)
