"""What windows show that a component needs, though it may not have kept up with it.

Who keeps up needs what it used. Who does not needs jobs per second x CPU time per job:
for jobs that came and wait, more than it used; for those that had waited, less.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

from msgspec import Struct

from poise.estimate.window import Window

_BEHIND = 0.02
"""Jobs under way at the ends of a window are no backlog yet: up to one in so many."""


class Demand(Struct, frozen=True):
    """What is needed [cores], and how far off that may be as jobs were under way.

    `error` is None when too few jobs were ended to tell what one costs: then `cores` is
    what was used.
    """

    cores: float
    error: float | None


class Sums:
    """Totals over windows."""

    __slots__ = ("asked", "cpu", "done", "seconds")

    def __init__(self, windows: Iterable[Window] = ()) -> None:
        self.seconds = self.cpu = 0.0
        self.asked = self.done = 0
        for window in windows:
            self.add(window, 1)

    def add(self, window: Window, sign: Literal[-1, 1]) -> None:
        """Count a window, or count it no more."""
        self.seconds += sign * window.seconds
        self.cpu += sign * window.cpu
        self.asked += sign * window.asked
        self.done += sign * window.done

    @property
    def is_in_step(self) -> bool:
        """Whether about as many jobs were ended as came."""
        return abs(self.asked - self.done) <= 1 + _BEHIND * self.asked

    @property
    def undone(self) -> float:
        """The share of the jobs that came and were not ended; in [0, 1]."""
        if self.is_in_step:
            return 0.0
        return max(0.0, 1 - self.done / self.asked) if self.asked else 0.0


def demand_in(windows: Sequence[Window]) -> Demand:
    """Return what was needed in windows that follow each other; at least one."""
    total = Sums(windows)
    used = total.cpu / total.seconds
    if total.is_in_step:
        return Demand(used, used * abs(total.asked - total.done) / max(total.done, 1))
    # What is under way at either end of the windows is left out: of a starved component
    # that may be more than all that was ended.
    ends = [at for at, window in enumerate(windows) if window.done]
    between = windows[ends[0] + 1 : ends[-1] + 1] if ends else ()
    jobs = Sums(between)
    if jobs.cpu <= 0:
        return Demand(used, None)
    cost = jobs.cpu / jobs.done
    cores = total.asked / total.seconds * cost
    # one window may belong to another job, and one job more or less have come
    unsure = max(window.cpu for window in between) / jobs.cpu
    return Demand(cores, cores * unsure + cost / total.seconds)
