"""Estimates the demand of a running component over the last `SPAN` seconds.

The CPU time of a starved component is not its demand, nor is that of one that works off
a backlog: the demand is then arriving jobs x CPU time per job, and while one job runs
on, what that uses. Windows that give only a lower bound count only if they raise it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Sequence
from itertools import islice
from typing import Literal

from msgspec import Struct

from poise.estimate._change_point import OUTLIER, ChangePointDetector
from poise.estimate.profiles import error_of_mean, quantile

_SATURATED = 0.9
"""A component that is runnable for this share of a window may need more than it got."""
_STARVED = 0.1
"""A component that waits for this share of its runnable time is starved."""
CPU_LEFT = 0.9
"""Where CPU was to be had in this share of the time, none lacked it."""
_BEHIND = 0.02
"""Up to this share of the jobs may be under way without being a backlog."""


class Reading(Struct, frozen=True):
    """A component's counters since it was activated."""

    at: float  # when they were read [s], on the clock of its own computer
    cpu: float  # CPU time used [s], as of the reference computer
    # time in which it was runnable and did not run, because other processes ran or its
    # computer was throttled [s], x the speed, as `cpu`
    wait: float = 0.0
    # asked, done: Jobs (releases of timers, messages, calls) that arrived, and that
    # ended
    asked: int = 0
    done: int = 0
    speed: float = 1.0  # of its computer: CPU time that a second of a core gives
    # whether its computer and its interpreter had CPU left since the reading before
    had_cpu_left: bool = False


class Window(Struct, frozen=True):
    """The work of a component between two readings."""

    seconds: float  # length [s]; > 0
    # CPU time used [s]. A call counts for its caller until it is first seen (0.2 s at
    # most) or ends, then for its callee: the caller's may then be below zero
    cpu: float
    asked: int = 0  # asked, done: Jobs that arrived, and that ended
    done: int = 0
    # whether it was runnable nearly all the time and waited often, so that its CPU time
    # is only a lower bound of its demand
    is_cut: bool = False
    had_cpu_left: bool = False  # as `Reading.had_cpu_left`


def window_between(before: Reading, after: Reading) -> Window | None:
    """Return the window between two readings; None when there is none.

    There is none when no time passed, or when the component restarted: its counters
    are then lower, or its CPU time is no more than the time since.
    """
    seconds = after.at - before.at
    cpu, wait = after.cpu - before.cpu, after.wait - before.wait
    asked, done = after.asked - before.asked, after.done - before.done
    is_new = min(wait, asked, done) < 0 or (cpu < 0 and after.cpu <= seconds)
    if seconds <= 0 or is_new:
        return None
    wanted = cpu + wait
    return Window(
        seconds,
        cpu,
        asked,
        done,
        wanted >= _SATURATED * seconds * after.speed and wait >= _STARVED * wanted,
        after.had_cpu_left,
    )


class Demand(Struct, frozen=True):
    """A demand [cores], and its error because jobs were under way.

    `error` is None when too few jobs ended to know the CPU time of one; `cores` is then
    the CPU that was used.
    """

    cores: float
    error: float | None


class Sums:
    """Totals over windows."""

    __slots__ = ("asked", "cpu", "done", "seconds", "with_cpu_left")

    def __init__(self, windows: Iterable[Window] = ()) -> None:
        self.seconds = self.cpu = self.with_cpu_left = 0.0
        self.asked = self.done = 0
        for window in windows:
            self.add(window, 1)

    def add(self, window: Window, sign: Literal[-1, 1]) -> None:
        """Add a window, or remove it."""
        self.seconds += sign * window.seconds
        self.with_cpu_left += sign * window.seconds * window.had_cpu_left
        self.cpu += sign * window.cpu
        self.asked += sign * window.asked
        self.done += sign * window.done

    @property
    def off_step(self) -> int:
        """How many jobs arrived more or less than ended; 1 at most if CPU was left."""
        undone = self.asked - self.done
        return min(undone, 1) if undone > 0 and self._had_cpu_left else abs(undone)

    @property
    def _had_cpu_left(self) -> bool:
        return self.with_cpu_left >= CPU_LEFT * self.seconds

    @property
    def is_in_step(self) -> bool:
        """Whether about as many jobs ended as arrived, or none of them lacked CPU."""
        undone = self.asked - self.done
        is_near = abs(undone) <= 1 + _BEHIND * self.asked
        return is_near or (undone > 0 and self._had_cpu_left)

    @property
    def undone(self) -> float:
        """The share of the arrived jobs that did not end; in [0, 1]."""
        if self.is_in_step:
            return 0.0
        return max(0.0, 1 - self.done / self.asked) if self.asked else 0.0


def demand_in(windows: Sequence[Window], total: Sums | None = None) -> Demand:
    """Return the demand in consecutive windows; at least one."""
    total = total or Sums(windows)
    used = total.cpu / total.seconds
    if total.is_in_step:
        return Demand(used, used * total.off_step / max(total.done, 1))
    # Jobs under way at either end of the windows are left out: a starved component may
    # have more of them than ended jobs.
    ends = [at for at, window in enumerate(windows) if window.done]
    first, last = (ends[0] + 1, ends[-1] + 1) if ends else (0, 0)
    cpu = [window.cpu for window in islice(windows, first, last)]
    if (cpu_of_jobs := sum(cpu)) <= 0:
        return Demand(used, None)
    cost = cpu_of_jobs / (total.done - windows[ends[0]].done)
    cores = total.asked / total.seconds * cost
    # one window may belong to another job, and one job more or less may have arrived
    unsure = max(cpu) / cpu_of_jobs
    return Demand(cores, cores * unsure + cost / total.seconds)


AFTER, USED = 2.0, 1.0
"""A job is looked at when it has run for this time [s] and used this much CPU [s]."""
_OUTWEIGHS = 3.0
"""It must have used this many times the CPU of any job before."""
_AT_WORK = 0.05
"""A component with less use than this has no job that computes [cores]."""


class PresentJob:
    """The job at which a component has been since the last one ended."""

    def __init__(self) -> None:
        self.is_long = False
        """Whether it stands out among the jobs before."""
        self.windows = 0
        self.seconds = self.cpu = 0.0
        self._asked = 0
        self._costliest = 0.0
        self._only_answers = True

    def add(self, window: Window) -> None:
        """Add the next window; one without work means that there is no job."""
        if window.asked != window.done:  # calls count as asked for when they end
            self._only_answers = False
        if window.done > 0:
            cost = (self.cpu + window.cpu) / window.done
            self._costliest = max(self._costliest, cost)
        if window.done > 0 or window.cpu < _AT_WORK * window.seconds:
            self.windows, self.seconds, self.cpu, self._asked = 0, 0.0, 0.0, 0
            self.is_long = False
            return
        self.windows += 1
        self._asked += window.asked
        self.seconds += window.seconds
        self.cpu += window.cpu
        self.is_long = (
            self.seconds >= AFTER - 1e-6  # windows are rounded
            and self.cpu >= max(USED, _OUTWEIGHS * self._costliest)
            # else it answers calls between two jobs of its own
            and (self._asked > 0 or self._only_answers)
        )


SPAN = 30.0
"""An estimate covers this time [s]."""
_LATELY, _NOW = 50, 10
"""Without jobs, a component is called starved by so many windows; where at least half
of so few give only a lower bound, what it used in them is one of its demand."""
_NEW = 1 / 6
"""How much single windows differ is looked at when this share of them is new."""
LEAST_SHARE = 0.25
LEAST_CORES = 0.01
"""A demand that differs by less than this share, or by fewer cores, is unchanged."""
_IDLE_FOR = 5.0
"""One that did nothing for this time [s] and then works needs what it uses: nothing is
known of its noise."""


class Drift(Struct, frozen=True):
    """A changed demand: the time [s], the demand before and after [cores].

    `after` covers the windows since the change, two seconds or more, and is rough.
    """

    at: float
    before: float
    after: float


class Estimate(Struct, frozen=True, kw_only=True):
    """The present demand of a component [cores].

    Parameters
    ----------
    mean, p95
        Over the windows of the last `SPAN` seconds, `p95` of single windows.
    error
        Half the width of the mean's 95 % confidence interval; None: too few windows, or
        too few jobs ended to know the CPU time of one.
    starved
        The share of its jobs that were not done for lack of CPU or, without jobs, of
        its last windows that give only a lower bound; in [0, 1].
    is_least
        Whether it may need more than `mean`: it lacked CPU, and has no jobs to count.
    long_job
        For how long a job has run that used far more CPU than any before, and has not
        ended [s]; 0: there is none.
    drift
        The last change within the span; None: there was none.
    """

    mean: float
    p95: float
    error: float | None
    starved: float = 0.0
    is_least: bool = False
    long_job: float = 0.0
    drift: Drift | None = None


def _share_of_cut(windows: Collection[Window]) -> float:
    return sum(window.is_cut for window in windows) / len(windows)


class RunningEstimate:
    """The running estimate of one component."""

    def __init__(self, expected: float | None = None, repeat: float = 0.0) -> None:
        self._repeat = repeat
        self._last: Reading | None = None
        self._windows: deque[Window] = deque()
        self._sums = Sums()
        self._lately: deque[Window] = deque(maxlen=_LATELY)
        self._spread: tuple[float, float | None] = 0.0, None
        self._since_spread = 0
        self._has_jobs = False
        self._job = PresentJob()
        self._drift: Drift | None = None
        self._load = ChangePointDetector(expected)
        self._cost = ChangePointDetector()
        self._asked = ChangePointDetector()

    def skip_to_next(self) -> None:
        """Ignore the time until the next reading; keep the estimate."""
        self._last = None

    def update(self, reading: Reading) -> Drift | None:
        """Add a reading; return the drift that it confirms, if any."""
        before, self._last = self._last, reading
        window = window_between(before, reading) if before else None
        if window is not None:
            self._lately.append(window)
        if window is None or (window.is_cut and self._is_useless(window)):
            return None
        self._keep(window)
        was_long = self._has_jobs and self._job.is_long
        self._job.add(window)
        is_long = self._has_jobs and self._job.is_long
        if was_long:
            if not is_long:
                self._start_again(None, 1)
            return None
        if is_long or (self._job.is_long and self._was_idle()):
            drift = self._drift_since(self._job.windows, reading.at)
            self._start_again(drift, self._job.windows)
            return drift
        since = self._changed_since(window)
        if not since:
            return None
        drift = self._drift_since(since, reading.at)
        if drift is not None:
            self._start_again(drift, since)
            return drift
        # jobs are costlier or more frequent, but the demand is as expected
        self._cost, self._asked = ChangePointDetector(), ChangePointDetector()
        return None

    def estimate(self) -> Estimate | None:
        """Return the estimate; None before the second reading."""
        if not self._windows:
            return None
        sums = self._sums
        used, is_long = sums.cpu / sums.seconds, self._has_jobs and self._job.is_long
        demand = Demand(used, 0.0) if is_long else demand_in(self._windows, sums)
        scale = demand.cores / used if used > 0 else 1.0
        p95, error = self._spread_of_windows()
        cut = 0.0 if self._has_jobs else _share_of_cut(self._lately)
        least = None if self._has_jobs else self._used_while_short()
        if least is not None and least.cores > demand.cores:
            demand, error = least, 0.0
        if error is not None:
            error = None if demand.error is None else scale * error + demand.error
        return Estimate(
            mean=max(0.0, demand.cores),  # `Window` says why it may be below
            p95=scale * p95,
            error=error,
            starved=0.0 if is_long else sums.undone or cut,
            is_least=cut >= _STARVED,
            long_job=self._job.seconds if is_long else 0.0,
            drift=self._drift,
        )

    def _used_while_short(self) -> Demand | None:
        """Return what it uses now that it lacks CPU; None: it does not."""
        now = list(self._lately)[-_NOW:]
        if _share_of_cut(now) < 1 / 2:
            return None
        loads = [window.cpu / window.seconds for window in now]
        return Demand(sum(loads) / len(loads), error_of_mean(loads))

    def _was_idle(self) -> bool:
        """Whether a long job without others came after it did nothing for long."""
        if self._has_jobs:
            return False
        seconds = self._sums.seconds - self._job.seconds
        cpu = self._sums.cpu - self._job.cpu
        return seconds >= _IDLE_FOR and cpu <= LEAST_CORES * seconds

    def _spread_of_windows(self) -> tuple[float, float | None]:
        """Return the p95 of single windows, and the error of their mean [cores]."""
        if self._since_spread >= _NEW * len(self._windows):
            loads = [window.cpu / window.seconds for window in self._windows]
            self._spread = quantile(loads, 0.95), error_of_mean(loads)
            self._since_spread = 0
        return self._spread

    def _is_useless(self, window: Window) -> bool:
        """Whether a lower bound, which is all that it gives, is known already."""
        return (
            not self._has_jobs
            and bool(self._windows)
            and window.cpu / window.seconds <= self._sums.cpu / self._sums.seconds
        )

    def _keep(self, window: Window) -> None:
        self._has_jobs = self._has_jobs or window.asked > 0 or window.done > 0
        self._windows.append(window)
        self._sums.add(window, 1)
        self._since_spread += 1
        while self._sums.seconds - self._windows[0].seconds >= SPAN:
            self._sums.add(self._windows.popleft(), -1)

    def _changed_since(self, window: Window) -> int:
        """Return how many windows ago the demand seems to have changed; 0: it has not.

        Detectors watch the load and, if there are jobs, CPU time per job and jobs per
        second. CPU time per job is steadier than the load, whose windows contain one
        job or none, and it is still right under overload, when the load is not.
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
        """Return how the last windows differ from the expected; None: too little."""
        windows = list(self._windows)
        recent = windows[-since:]
        before = self._load.reference
        if before is None:  # starved from the start
            before = demand_in(windows[: max(1, len(windows) - since)]).cores
        least = max(LEAST_SHARE * before, LEAST_CORES, self._repeat)
        parts = (
            recent[:first] + recent[first + OUTLIER :]
            for first in range(max(1, len(recent) - OUTLIER + 1))
        )
        if any(abs(demand_in(part).cores - before) <= least for part in parts if part):
            return None
        return Drift(at, before, demand_in(recent).cores)

    def _start_again(self, drift: Drift | None, since: int) -> None:
        """Forget the windows before the change."""
        kept = list(self._windows)[-since:]
        self._windows, self._sums = deque(), Sums()
        for window in kept:
            self._keep(window)
        self._drift = drift
        self._load = ChangePointDetector()
        self._cost, self._asked = ChangePointDetector(), ChangePointDetector()
