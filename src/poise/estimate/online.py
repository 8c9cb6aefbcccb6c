"""What a component needs, estimated while it runs.

The estimate is over the last `SPAN` seconds, and starts anew when the demand has
shifted. The CPU time of a component that was kept from running is not its demand, and
neither is that of one that works off what was left: jobs that came are then counted at
what a job costs (`poise.estimate.demand`). Windows that tell only a lower bound count
only when they raise the estimate.
"""

from __future__ import annotations

from collections import deque

from msgspec import Struct

from poise.estimate.change_point import OUTLIER, ChangePointDetector
from poise.estimate.demand import Sums, demand_in
from poise.estimate.profile.spread import error_of_mean, quantile
from poise.estimate.window import Reading, Window, window_between

SPAN = 30.0
"""An estimate looks back so far [s]."""
LEAST_SHARE = 0.25
LEAST_CORES = 0.01
"""A demand that differs by less than this share, or so many cores, has not shifted."""


class Drift(Struct, frozen=True):
    """A demand that has shifted: when [s], and from what to what [cores].

    `after` comes from the windows since the shift, two seconds or more, and is rough.
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
        Half the width of the mean's 95 % confidence interval; None: too few windows, or
        too few jobs ended since it is starved to tell what one costs.
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
        self._repeat = repeat
        self._last: Reading | None = None
        self._windows: deque[Window] = deque()
        self._sums = Sums()
        self._has_jobs = False
        self._drift: Drift | None = None
        self._load = ChangePointDetector(expected)
        self._cost = ChangePointDetector()
        self._asked = ChangePointDetector()

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
        since = self._changed_since(window)
        if not since:
            return None
        drift = self._drift_since(since, reading.at)
        if drift is not None:
            self._start_again(drift, since)
            return drift
        # dearer jobs or more of them, but no more is needed than was expected
        self._cost, self._asked = ChangePointDetector(), ChangePointDetector()
        return None

    def estimate(self) -> Estimate | None:
        """Return what it needs; None before the second reading."""
        if not self._windows:
            return None
        demand = demand_in(list(self._windows))
        used = self._sums.cpu / self._sums.seconds
        scale = demand.cores / used if used > 0 else 1.0
        loads = [scale * w.cpu / w.seconds for w in self._windows]
        error = error_of_mean(loads)
        if error is not None:
            error = None if demand.error is None else error + demand.error
        cut = sum(w.is_cut for w in self._windows) / len(self._windows)
        return Estimate(
            mean=demand.cores,
            p95=quantile(loads, 0.95),
            error=error,
            starved=self._sums.undone or cut,
            drift=self._drift,
        )

    def _is_useless(self, window: Window) -> bool:
        """Whether it tells only a lower bound, and one that is known already."""
        return (
            window.is_cut
            and not self._has_jobs
            and bool(self._windows)
            and window.cpu / window.seconds <= self._sums.cpu / self._sums.seconds
        )

    def _keep(self, window: Window) -> None:
        self._has_jobs = self._has_jobs or window.asked > 0 or window.done > 0
        self._windows.append(window)
        self._sums.add(window, 1)
        while self._sums.seconds - self._windows[0].seconds >= SPAN:
            self._sums.add(self._windows.popleft(), -1)

    def _changed_since(self, window: Window) -> int:
        """Return how many windows ago it seems to have shifted; 0: it has not.

        Watched are the load and, where there are jobs, cost per job and jobs per
        second. A job's CPU time is steadier than the load, whose windows hold now one
        job and now none; and under overload a job still costs what it costs, while the
        load says nothing then.
        """
        since = 0
        keeps_up = not window.is_cut and self._sums.is_in_step
        if keeps_up and self._load.update(window.cpu, window.seconds):
            since = self._load.since
        if self._has_jobs:
            if self._cost.update(window.cpu, window.done):
                since = max(since, self._cost.since)
            if self._asked.update(window.asked, window.seconds):
                since = max(since, self._asked.since)
        return since

    def _drift_since(self, since: int, at: float) -> Drift | None:
        """Return how the last windows differ from what was expected; None: too little.

        They must do so without the second in which they differ most, too: that may have
        been a outlier, such as a machine that stood still.
        """
        windows = list(self._windows)
        recent = windows[-since:]
        before = self._load.reference
        if before is None:  # it was starved from the start
            before = demand_in(windows[: max(1, len(windows) - since)]).cores
        least = max(LEAST_SHARE * before, LEAST_CORES, self._repeat)
        parts = (
            recent[:first] + recent[first + OUTLIER :]
            for first in range(max(1, len(recent) - OUTLIER + 1))
        )
        if any(abs(demand_in(part).cores - before) <= least for part in parts if part):
            return None
        return Drift(at, before, demand_in(recent).cores)

    def _start_again(self, drift: Drift, since: int) -> None:
        """Forget what was before the shift."""
        kept = list(self._windows)[-since:]
        self._windows, self._sums = deque(), Sums()
        for each in kept:
            self._keep(each)
        self._drift = drift
        self._load, self._cost, self._asked = (
            ChangePointDetector(),
            ChangePointDetector(),
            ChangePointDetector(),
        )
