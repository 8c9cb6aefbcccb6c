"""When a timer is due, and whether it kept its deadline. Pure: time is an argument."""

from __future__ import annotations

from poise.runtime.component.ports import Timer
from poise.runtime.execution.histogram import Histogram
from poise.wire.records.deployment import TimerStatus


class Timers:
    """The releases of a timer, at `start` + k * period for k = 1, 2, ...

    Parameters
    ----------
    timer
        Period and deadline.
    start
        The moment of activation [s].
    """

    def __init__(self, timer: Timer, start: float) -> None:
        self.timer = timer
        self._start = start
        self._next = 1
        self._missed = 0
        self._lateness = Histogram()
        self._duration = Histogram()

    @property
    def due(self) -> float:
        """The next release [s]."""
        return self._start + self._next * self.timer.period

    @property
    def releases(self) -> tuple[float, float]:
        """Where the releases lie: `start` and period [s]."""
        return self._start, self.timer.period

    def begin(self, now: float) -> float:
        """Take the last release that is due at `now` [s] and return it [s].

        Earlier ones that never began are skipped, and missed.
        """
        last = max(self._next, int((now - self._start) / self.timer.period))
        if self.timer.deadline is not None:
            self._missed += last - self._next
        self._next = last + 1
        release = self._start + last * self.timer.period
        self._lateness.add(now - release)
        return release

    def end(self, release: float, began: float, now: float) -> None:
        """Count the run of `release` that lasted from `began` to `now` [s]."""
        self._duration.add(now - began)
        deadline = self.timer.deadline
        if deadline is not None and now - release > deadline:
            self._missed += 1

    def status(self, now: float) -> TimerStatus:
        """Return what was counted; releases that should have begun by now are in."""
        passed = max(self._next - 1, int((now - self._start) / self.timer.period) - 1)
        waiting = passed - (self._next - 1) if self.timer.deadline is not None else 0
        return TimerStatus(
            name=self.timer.name,
            period=self.timer.period,
            deadline=self.timer.deadline,
            releases=passed,
            missed=self._missed + waiting,
            lateness=self._lateness.summary(),
            duration=self._duration.summary(),
        )
