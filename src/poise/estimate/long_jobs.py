"""Finds jobs that run on: what such a job uses is what its component needs now.

Jobs per second x CPU time per job says nothing of a job that does not end. A job stands
out when it has used several times the CPU of the costliest one before.
"""

from __future__ import annotations

from poise.estimate.demand_windows import Window

AFTER, USED = 2.0, 1.0
"""A job is looked at when it has run for this time [s] and used this much CPU [s]."""
_OUTWEIGHS = 3.0
"""It must have used this many times the CPU of any job before."""
_AT_WORK = 0.05
"""A component with less use than this has no job that computes [cores]."""


class PresentJob:
    """The job at which a component has been since the last one ended.

    Attributes
    ----------
    windows, seconds, cpu
        How many windows it fills, how long it has run, and what it used [s].
    """

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
        # windows are rounded
        has_lasted = self.seconds >= AFTER - 1e-6
        outweighs = self.cpu >= max(USED, _OUTWEIGHS * self._costliest)
        # else it answers calls between two jobs of its own
        is_job = self._asked > 0 or self._only_answers
        return has_lasted and outweighs and is_job
