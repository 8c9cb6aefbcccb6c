"""Which timers miss their deadlines now."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from msgspec import Struct

from poise.wire.records.deployment import AgentStatus, TimerStatus

_SEVERAL, _MISSED = 2, 0.2
"""A timer that misses so many deadlines, and this share of them, is late."""
OVER = 1.0
"""Misses are counted over this time [s], or over the last release of a slow timer."""


class Misses(Struct, frozen=True, kw_only=True):
    """How one timer kept its deadline lately.

    Parameters
    ----------
    released, missed
        Releases in the last second, and how many of these missed the deadline.
    """

    component: str
    computer: str
    timer: str
    released: int
    missed: int

    @property
    def share(self) -> float:
        """The share that missed; in [0, 1]."""
        return self.missed / self.released if self.released else 0.0

    @property
    def is_late(self) -> bool:
        """Whether it does not keep its rate: a single miss among others is no sign."""
        several = self.missed >= _SEVERAL and self.share >= _MISSED
        return several or 0 < self.released == self.missed


class DeadlineMisses:
    """Compares the totals of statuses over the last second."""

    def __init__(self) -> None:
        self._totals: dict[tuple[str, int, str], deque[tuple[float, int, int]]] = {}

    def look(
        self, statuses: Mapping[str, AgentStatus], now: float
    ) -> tuple[Misses, ...]:
        """Return the timers with a deadline that were due within the last second.

        Parameters
        ----------
        now
            A time that never goes back [s].
        """
        found, before = [], self._totals
        self._totals = {}
        for computer, status in statuses.items():
            for container in status.containers:
                for component in container.components:
                    for timer in component.timers:
                        if timer.deadline is None:
                            continue
                        key = component.name, component.epoch, timer.name
                        totals = before.get(key, deque())
                        self._totals[key] = totals
                        released, missed = _count(totals, timer, now)
                        if released:
                            found.append(
                                Misses(
                                    component=component.name,
                                    computer=computer,
                                    timer=timer.name,
                                    released=released,
                                    missed=missed,
                                )
                            )
        return tuple(found)


def _count(
    totals: deque[tuple[float, int, int]], timer: TimerStatus, now: float
) -> tuple[int, int]:
    """Add a timer's totals; return what was released and missed since a second ago."""
    if not totals or totals[-1][1:] != (timer.releases, timer.missed):
        totals.append((now, timer.releases, timer.missed))
    while len(totals) > 1 and now - totals[1][0] >= OVER:
        totals.popleft()
    _, releases, missed = totals[0]
    return timer.releases - releases, timer.missed - missed
