"""Windows between readings of a component's counters, and its demand in them.

A component that keeps up needs the CPU that it used. Otherwise its demand is jobs per
second x CPU time per job: more than it used while a backlog grows, less while it
shrinks.

Jobs per second x CPU time per job says nothing of a job that does not end. A job stands
out when it has used several times the CPU of the costliest one before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import islice
from typing import Literal

from msgspec import Struct

_SATURATED = 0.9
"""A component that is runnable for this share of a window may need more than it got."""
_STARVED = 0.1
"""A component that waits for this share of its runnable time is starved."""
_BEHIND = 0.02
"""Up to this share of the jobs may be under way without being a backlog."""


class Reading(Struct, frozen=True):
    """A component's counters since it was activated."""

    at: float  # when they were read [s], on the clock of its own computer
    cpu: float  # CPU time used [s]
    # time in which it was runnable and did not run, because other processes ran or its
    # computer was throttled [s]
    wait: float = 0.0
    # asked, done: Jobs (releases of timers, messages, calls) that arrived, and that
    # ended
    asked: int = 0
    done: int = 0


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
        wanted >= _SATURATED * seconds and wait >= _STARVED * wanted,
    )


class Demand(Struct, frozen=True):
    """A demand [cores], and its error because jobs were under way.

    `error` is None when too few jobs ended to know the CPU time of one; `cores` is then
    the CPU that was used.
    """

    cores: float
    error: float | None


class Sums:
    """Totals over windows; `cut` is how many are."""

    __slots__ = ("asked", "cpu", "cut", "done", "seconds")

    def __init__(self, windows: Iterable[Window] = ()) -> None:
        self.seconds = self.cpu = 0.0
        self.asked = self.done = self.cut = 0
        for window in windows:
            self.add(window, 1)

    def add(self, window: Window, sign: Literal[-1, 1]) -> None:
        """Add a window, or remove it."""
        self.seconds += sign * window.seconds
        self.cpu += sign * window.cpu
        self.asked += sign * window.asked
        self.done += sign * window.done
        self.cut += sign * window.is_cut

    @property
    def is_in_step(self) -> bool:
        """Whether about as many jobs ended as arrived."""
        return abs(self.asked - self.done) <= 1 + _BEHIND * self.asked

    @property
    def undone(self) -> float:
        """The share of the arrived jobs that did not end; in [0, 1]."""
        if self.is_in_step:
            return 0.0
        return max(0.0, 1 - self.done / self.asked) if self.asked else 0.0


def demand_in(windows: Collection[Window], total: Sums | None = None) -> Demand:
    """Return the demand in consecutive windows; at least one."""
    total = total or Sums(windows)
    used = total.cpu / total.seconds
    if total.is_in_step:
        return Demand(used, used * abs(total.asked - total.done) / max(total.done, 1))
    # Jobs under way at either end of the windows are left out: a starved component may
    # have more of them than ended jobs.
    ends = [at for at, window in enumerate(windows) if window.done]
    first, last = (ends[0] + 1, ends[-1] + 1) if ends else (0, 0)
    between = list(islice(windows, first, last))
    jobs = Sums(between)
    if jobs.cpu <= 0:
        return Demand(used, None)
    cost = jobs.cpu / jobs.done
    cores = total.asked / total.seconds * cost
    # one window may belong to another job, and one job more or less may have arrived
    unsure = max(window.cpu for window in between) / jobs.cpu
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
            return
        self.windows += 1
        self._asked += window.asked
        self.seconds += window.seconds
        self.cpu += window.cpu

    @property
    def is_long(self) -> bool:
        """Whether it stands out among the jobs before."""
        if self.seconds < AFTER - 1e-6:  # windows are rounded
            return False
        outweighs = self.cpu >= max(USED, _OUTWEIGHS * self._costliest)
        # else it answers calls between two jobs of its own
        is_job = self._asked > 0 or self._only_answers
        return outweighs and is_job
