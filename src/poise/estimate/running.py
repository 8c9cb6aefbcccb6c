"""What a component needs, estimated while it runs.

The estimate is over the last `SPAN` seconds, and starts anew when the demand has
shifted. The CPU time of a component that was kept from running is not its demand:
jobs that came and were not done are counted at what a job costs, and windows that tell
only a lower bound count only when they raise the estimate.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

from msgspec import Struct

from poise.estimate.reading import Reading, Window, window_between
from poise.estimate.shift import Shift
from poise.estimate.spread import error_of_mean, quantile

SPAN = 30.0
"""An estimate looks back so far [s]."""
LEAST_SHARE = 0.25
LEAST_CORES = 0.01
"""A demand that differs by less than this share, or so many cores, has not shifted."""
_BEHIND = 0.02
"""Jobs under way at the ends of a window are not yet backlog: up to one in so many."""
_LARGEST_SCALE = 100.0


class Drift(Struct, frozen=True):
    """A demand that has shifted: when [s], and from what to what [cores].

    `after` comes from the few windows since the shift, and is rough.
    """

    at: float
    before: float
    after: float


class Estimate(Struct, frozen=True, kw_only=True):
    """What a component needs now [cores].

    Parameters
    ----------
    mean, p95
        Over the windows of the last `SPAN` seconds, `p95` of single windows.
    error
        Half the width of the mean's 95 % confidence interval; None: too few windows.
    starved
        The share of its jobs, or of its windows when it has no jobs, that went undone
        or tell only a lower bound; in [0, 1].
    drift
        The last shift within the span; None: there was none.
    """

    mean: float
    p95: float
    error: float | None
    starved: float = 0.0
    drift: Drift | None = None


class _Sums:
    """Totals over the windows that are kept; they hold no more than `SPAN`."""

    __slots__ = ("asked", "cpu", "done", "seconds")

    def __init__(self) -> None:
        self.seconds = self.cpu = 0.0
        self.asked = self.done = 0

    def add(self, window: Window, sign: Literal[-1, 1]) -> None:
        self.seconds += sign * window.seconds
        self.cpu += sign * window.cpu
        self.asked += sign * window.asked
        self.done += sign * window.done


def _scale(sums: _Sums) -> float:
    """Return demand / CPU time: jobs that came per job that was done; >= 1."""
    asked, done = sums.asked, sums.done
    if asked - done <= 1 + _BEHIND * asked:
        return 1.0
    return min(asked / max(done, 1), _LARGEST_SCALE)


class RunningEstimate:
    """The running estimate of one component.

    Parameters
    ----------
    expected
        Its mean demand by the profile [cores]: what drift is measured against. None:
        against what it needs at first.
    repeat
        How far repeated measurements for the profile lay apart [cores]: by so much it
        may differ, too, and not have shifted.
    """

    def __init__(self, expected: float | None = None, repeat: float = 0.0) -> None:
        self._expected = expected
        self._repeat = repeat
        self._last: Reading | None = None
        self._windows: deque[Window] = deque()
        self._sums = _Sums()
        self._has_jobs = False
        self._drift: Drift | None = None
        self._load = Shift(expected)
        self._cost = Shift()
        self._asked = Shift()

    def begin_anew(self) -> None:
        """Let the next reading count from itself on; what is known stays."""
        self._last = None

    def update(self, reading: Reading) -> Drift | None:
        """Take a reading; return the drift that it made certain, if it did."""
        before, self._last = self._last, reading
        window = window_between(before, reading) if before else None
        if window is None or self._is_useless(window):
            return None
        self._keep(window)
        if not self._has_shifted(window):
            return None
        drift = self._drift_at(reading.at)
        if abs(drift.after - drift.before) > self._tolerated(drift.before):
            self._start_again(drift)
            return drift
        # dearer jobs or more of them, but no more is needed than was expected
        self._cost, self._asked = Shift(), Shift()
        return None

    def estimate(self) -> Estimate | None:
        """Return what it needs; None before the second reading."""
        if not self._windows:
            return None
        scale = _scale(self._sums)
        loads = [scale * w.cpu / w.seconds for w in self._windows]
        cut = sum(w.is_cut for w in self._windows) / len(self._windows)
        return Estimate(
            mean=self._mean() * scale,
            p95=quantile(loads, 0.95),
            error=error_of_mean(loads),
            starved=1 - 1 / scale if scale > 1 else cut,
            drift=self._drift,
        )

    def _is_useless(self, window: Window) -> bool:
        """Whether it tells only a lower bound, and one that is known already."""
        return (
            window.is_cut
            and not self._has_jobs
            and bool(self._windows)
            and window.cpu / window.seconds <= self._mean()
        )

    def _keep(self, window: Window) -> None:
        self._has_jobs = self._has_jobs or window.asked > 0 or window.done > 0
        self._windows.append(window)
        self._sums.add(window, 1)
        while self._sums.seconds - self._windows[0].seconds >= SPAN:
            self._sums.add(self._windows.popleft(), -1)

    def _mean(self) -> float:
        return self._sums.cpu / self._sums.seconds

    def _has_shifted(self, window: Window) -> bool:
        """Watch the load and, where there are jobs, cost per job and jobs per second.

        A job's CPU time is steadier than the load, whose windows hold now one job and
        now none; and under overload a job still costs what it costs, while the load
        says nothing then.
        """
        by_load = by_cost = by_rate = 0
        if not window.is_cut and _scale(self._sums) <= 1:
            by_load = self._load.update(window.cpu, window.seconds)
        if self._has_jobs:
            by_cost = self._cost.update(window.cpu, window.done)
            by_rate = self._asked.update(window.asked, window.seconds)
        return bool(by_load or by_cost or by_rate)

    def _tolerated(self, demand: float) -> float:
        return max(LEAST_SHARE * demand, LEAST_CORES, self._repeat)

    def _drift_at(self, at: float) -> Drift:
        """Return the shift that the last second shows, from what was expected."""
        before = self._old_mean() if self._expected is None else self._expected
        recent = _Sums()
        for each in self._recent():
            recent.add(each, 1)
        after = recent.cpu / recent.seconds
        return Drift(at, before, after * _scale(recent))

    def _start_again(self, drift: Drift) -> None:
        """Forget what was before the shift: the windows of the last second stay."""
        kept = self._recent()
        self._windows, self._sums = deque(), _Sums()
        for each in kept:
            self._keep(each)
        self._expected, self._drift = None, drift
        self._load, self._cost, self._asked = Shift(), Shift(), Shift()

    def _recent(self) -> list[Window]:
        count = max(1, math.ceil(1.0 / self._windows[-1].seconds))
        return list(self._windows)[-count:]

    def _old_mean(self) -> float:
        old = list(self._windows)[: max(1, len(self._windows) // 2)]
        return sum(w.cpu for w in old) / sum(w.seconds for w in old)
