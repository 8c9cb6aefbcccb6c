"""When a timer is due, and whether it kept its deadline. Pure: time is an argument."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from zlib import crc32

from poise.runtime._calls import Histogram
from poise.runtime.component.ports import Timer
from poise.wire.records.status_records import TimerStatus


def release_offset(component: str) -> float:
    """Return when a component's timers are released [s], by its name alone."""
    return crc32(component.encode()) / 2**32


class Releases:
    """The releases of a timer, at `start` + k * period for k = 1, 2, ..."""

    def __init__(self, timer: Timer, start: float) -> None:
        self.timer = timer
        self.start = start
        self._next = 1
        self._earlier = 0
        self._missed = 0
        self._lateness = Histogram()
        self._duration = Histogram()

    def restart(self, start: float, stopped: float) -> None:
        """Go on from another `start` after a pause since `stopped`; counts stay [s]."""
        self._earlier, self._missed = self._count(stopped), self.missed(stopped)
        self.start, self._next = start, 1

    @property
    def due(self) -> float:
        """The next release [s]."""
        return self.start + self._next * self.timer.period

    def begin(self, now: float) -> float:
        """Take and return the last release that is due at `now` [s]; skip earlier."""
        last = max(self._next, int((now - self.start) / self.timer.period))
        if self.timer.deadline is not None:
            self._missed += last - self._next
        self._next = last + 1
        release = self.start + last * self.timer.period
        self._lateness.add(now - release)
        return release

    def end(self, release: float, began: float, now: float) -> None:
        """Count the run of `release` that lasted from `began` to `now` [s]."""
        self._duration.add(now - began)
        deadline = self.timer.deadline
        if deadline is not None and now - release > deadline:
            self._missed += 1

    def missed(self, now: float) -> int:
        """Return how many missed the deadline until `now` [s]."""
        waiting = self._passed(now) - (self._next - 1)
        return self._missed + (waiting if self.timer.deadline is not None else 0)

    def _passed(self, now: float) -> int:
        """Return how many have begun, or should have by `now` [s]."""
        return max(self._next - 1, int((now - self.start) / self.timer.period) - 1)

    def _count(self, now: float) -> int:
        return self._earlier + self._passed(now)

    def status(self, now: float) -> TimerStatus:
        """Return what was counted; releases that should have begun by now are in."""
        return TimerStatus(
            name=self.timer.name,
            period=self.timer.period,
            deadline=self.timer.deadline,
            releases=self._count(now),
            missed=self.missed(now),
            lateness=self._lateness.summary(),
            duration=self._duration.summary(),
        )


class Timers:
    """All timers of a component, by name."""

    def __init__(self, declared: Mapping[str, Timer]) -> None:
        self._declared = declared
        self._first: Mapping[str, float] = {}
        self._releases: dict[str, Releases] = {}
        self._stopped_at: float | None = None

    def __iter__(self) -> Iterator[Releases]:
        return iter(list(self._releases.values()))

    def begin_at(self, first: Mapping[str, float]) -> None:
        """Let timers be due so when they start next [s]: a move keeps their phases."""
        self._first = first

    def start(self, now: float, elapsed: float = 0.0) -> list[tuple[float, float]]:
        """Start or go on at `now` [s]; return the start and the period of each [s]."""
        stopped, self._stopped_at = self._until(now), None
        first, self._first = self._first, {}
        for name, timer in self._declared.items():
            due = now + timer.period - elapsed % timer.period
            start = first.get(name, due) - timer.period
            if name in self._releases:
                self._releases[name].restart(start, stopped)
            else:
                self._releases[name] = Releases(timer, start)
        return [(releases.start, releases.timer.period) for releases in self]

    def stop(self, now: float) -> None:
        """Count no release after `now` [s]."""
        self._stopped_at = now

    def next_due(self) -> float | None:
        """Return when a timer is due next [s]; None when there is none."""
        return min((releases.due for releases in self), default=None)

    def left(self, now: float) -> dict[str, float]:
        """Return the time until each is due next [s]."""
        return {releases.timer.name: releases.due - now for releases in self}

    def missed(self, now: float) -> int:
        """Return how many releases missed their deadlines, as `status`."""
        until = self._until(now)
        return sum(releases.missed(until) for releases in self)

    def status(self, now: float) -> tuple[TimerStatus, ...]:
        """Return what was counted until `now` [s], or until they were stopped."""
        until = self._until(now)
        return tuple(releases.status(until) for releases in self)

    def _until(self, now: float) -> float:
        return now if self._stopped_at is None else self._stopped_at
