"""Which timers miss their deadlines now."""

from __future__ import annotations

from collections import deque

from poise.manage.agent_connections.statuses import Statuses, located
from poise.model.policy.policy import TimerValues
from poise.wire.records.status_records import TimerStatus

_SEVERAL, _MISSED = 2, 0.2
"""A timer is late that misses as many deadlines, and this share of them."""
OVER = 1.0
"""Misses are counted over this time [s], or over two periods of a slow timer."""


def is_late(times: int, missed: int) -> bool:
    """Return whether misses are too many to be a single one among others."""
    several = missed >= _SEVERAL and missed >= _MISSED * times
    return several or 0 < times == missed


class DeadlineMisses:
    """Compares the totals of statuses over the last seconds."""

    def __init__(self) -> None:
        self._totals: dict[tuple[str, int, str], deque[tuple[float, int, int]]] = {}

    def look(self, statuses: Statuses, now: float) -> tuple[TimerValues, ...]:
        """Return the timers with a deadline that were due lately.

        `now`: a time that never goes back [s].
        """
        found, before = [], self._totals
        self._totals = {}
        for computer, component in located(statuses):
            for timer in component.timers:
                if timer.deadline is None:
                    continue
                key = component.name, component.epoch, timer.name
                totals = self._totals[key] = before.get(key) or deque()
                seconds = max(OVER, 2 * timer.period)
                released, missed = _count(totals, timer, now, seconds)
                if released:
                    found.append(
                        TimerValues(
                            name=f"{component.name}.{timer.name}",
                            timer=timer.name,
                            component=component.name,
                            computer=computer,
                            released=released,
                            missed=missed,
                            share=missed / released,
                            over=seconds,
                            deadline=timer.deadline,
                            takes=timer.duration.p99,
                            late=is_late(released, missed),
                        )
                    )
        return tuple(found)


def _count(
    totals: deque[tuple[float, int, int]], timer: TimerStatus, now: float, over: float
) -> tuple[int, int]:
    """Add a timer's totals; return what was released and missed in the time [s].

    A status comes as soon as a deadline was missed, but else only once a second: the
    timer was released evenly since the one before. The time ends with the last status.
    """
    if not totals or totals[-1][1:] != (timer.releases, timer.missed):
        totals.append((now, timer.releases, timer.missed))
    while len(totals) > 1 and now - totals[1][0] >= over:
        totals.popleft()
    at, releases, missed = totals[0]
    if len(totals) > 1:
        next_at, later, _ = totals[1]
        past = max(0.0, totals[-1][0] - over - at) / (next_at - at)
        releases += round(past * (later - releases))
    released = timer.releases - releases
    return released, min(released, timer.missed - missed)
