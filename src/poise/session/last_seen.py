"""What a run's statuses said last of all that ran, also of what is gone since."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from itertools import groupby
from typing import TypeVar

from msgspec.structs import replace

from poise.manage.agent_connections.statuses import Statuses
from poise.wire.records.status_records import (
    AgentStatus,
    ChainStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    ErrorCount,
    Side,
    Summary,
    TimerStatus,
)

T = TypeVar("T", TimerStatus, ChainStatus)


def whole(stays: Sequence[ComponentStatus]) -> ComponentStatus:
    """Return the last status, with the counts of all stays, first to last."""
    return reduce(_after, stays)


def _after(before: ComponentStatus, last: ComponentStatus) -> ComponentStatus:
    measures = dict(before.measures)
    for name, values in last.measures.items():
        measures[name] = together(measures.get(name, Summary()), values)
    return replace(
        last,
        errors=before.errors + last.errors,
        error_counts=_errors(before.error_counts + last.error_counts),
        cpu=before.cpu + last.cpu,
        timers=tuple(_timer(_same(before.timers, each), each) for each in last.timers),
        chains=tuple(_chain(_same(before.chains, each), each) for each in last.chains),
        measures=measures,
    )


def together(one: Summary, other: Summary) -> Summary:
    """Return the summary of both; exact but for median and p99, of the larger one."""
    count = one.count + other.count
    if not count:
        return one
    larger = one if one.count > other.count else other
    return replace(
        larger,
        count=count,
        mean=(one.count * one.mean + other.count * other.mean) / count,
        maximum=max(each.maximum for each in (one, other) if each.count),
    )


def _same(before: Iterable[T], now: T) -> T | None:
    return next((each for each in before if each.name == now.name), None)


def _timer(before: TimerStatus | None, last: TimerStatus) -> TimerStatus:
    if before is None:
        return last
    return replace(
        last,
        releases=before.releases + last.releases,
        missed=before.missed + last.missed,
        lateness=together(before.lateness, last.lateness),
        duration=together(before.duration, last.duration),
    )


def _chain(before: ChainStatus | None, last: ChainStatus) -> ChainStatus:
    if before is None:
        return last
    missed, age = before.missed + last.missed, together(before.age, last.age)
    return replace(last, missed=missed, age=age)


def _errors(errors: Iterable[ErrorCount]) -> tuple[ErrorCount, ...]:
    found: dict[tuple[str, str], ErrorCount] = {}
    for error in errors:
        key = error.where, error.text
        known = found.get(key)
        count = error.count + (known.count if known else 0)
        found[key] = replace(known or error, count=count)
    return tuple(found.values())


Place = tuple[str, str]
"""Computer and container."""
_Stay = tuple[Place, int, int]
"""Where, in which process, and as which incarnation."""
_Ends = tuple[Place, int, list[ConnectorStatus]]
"""Where and in which process the ends of a connector are, and what they said last."""
_MOST = 50
"""Up to this number of stays of a component are kept apart."""


class LastSeen:
    """Keeps what is gone: components that ended or moved, and their connectors."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._containers: dict[Place, ContainerStatus] = {}
        self.ended: list[ConnectorStatus] = []
        self._joined: list[ConnectorStatus] = []
        self._places: dict[str, Place] = {}
        self._stays: dict[str, dict[_Stay, ComponentStatus]] = {}
        self._ends: dict[tuple[str, Side], _Ends] = {}

    def record(self, statuses: Statuses) -> None:
        """Record what the agents say now."""
        for _, status in sorted(statuses.items()):
            self.record_status(status)

    def record_status(self, status: AgentStatus) -> None:
        """Record what an agent says; any thread may."""
        with self._lock:
            for container in status.containers:
                self._record_container(status.computer, container)

    def _record_container(self, computer: str, container: ContainerStatus) -> None:
        place = computer, container.name
        before = self._containers.get(place, container)
        if before.pid != container.pid:
            for (_, side), (at, pid, known) in self._ends.items():
                # a source with two paths counts the same at both
                if (at, pid) == (place, before.pid):
                    self.ended += known[:1] if side == "source" else known
        self._containers[place] = container
        for component in container.components:
            self._places[component.name] = place
            stays = self._stays.setdefault(component.name, {})
            stays[place, container.pid, component.epoch] = component
            _fold(stays)
        ends = sorted(container.connectors, key=_key)
        for key, same in groupby(ends, _key):  # of a source with two paths
            now = list(same)
            at, pid, last = self._ends.get(key, (place, container.pid, now))
            has_ended = self._containers[at].pid != pid
            if not has_ended and last[0].count > now[0].count:
                self._joined += last[:1]  # it was joined again, and counts from 0
            self._ends[key] = place, container.pid, now

    def merged(self, statuses: Statuses) -> Statuses:
        """Return the statuses, with what was there before and is gone."""
        self.record(statuses)
        with self._lock:
            return self._merged(statuses)

    def _merged(self, statuses: Statuses) -> Statuses:
        ends = list(self._whole_ends())
        return {
            computer: replace(
                status,
                containers=tuple(
                    self._latest(place, container, ends)
                    for place, container in self._containers.items()
                    if place[0] == computer
                ),
            )
            for computer, status in statuses.items()
        }

    def connectors(self) -> Iterator[ConnectorStatus]:
        """Yield each end of each connector, with the counts of all its stays.

        What a container did after its last status is not known.
        """
        with self._lock:
            yield from (end for _, end in self._whole_ends())

    def stays(self) -> Iterator[tuple[str, ComponentStatus]]:
        """Yield each component's last status in each place, with its computer."""
        for stays in self._stays.values():
            for ((computer, _), _, _), status in stays.items():
                yield computer, status

    def _whole_ends(self) -> Iterator[tuple[Place, ConnectorStatus]]:
        """Yield where each end of each connector is, and what all its stays counted."""
        before: dict[tuple[str, Side], ConnectorStatus] = {}
        for end in (*self.ended, *self._joined):
            if any(end is each for each in self._ends[_key(end)][2]):
                continue  # no other took its place
            known = before.get(_key(end))
            before[_key(end)] = _end_after(known, end) if known else end
        for key, (place, _, same) in sorted(self._ends.items()):
            earlier = before.pop(key, None)
            adds = len(same) if key[1] == "source" else 1
            for each in same[:adds]:
                yield place, _end_after(earlier, each) if earlier else each
            yield from ((place, each) for each in same[adds:])

    def _latest(
        self,
        place: Place,
        container: ContainerStatus,
        ends: Iterable[tuple[Place, ConnectorStatus]],
    ) -> ContainerStatus:
        here = (name for name, at in self._places.items() if at == place)
        components = tuple(whole(list(self._stays[name].values())) for name in here)
        here_too = tuple(end for at, end in ends if at == place)
        return replace(container, components=components, connectors=here_too)


def _end_after(before: ConnectorStatus, last: ConnectorStatus) -> ConnectorStatus:
    """Return an end's last status, with what it had counted in a process before."""
    counts = "calls", "messages", "bytes_out", "bytes_in", "errors", "drops"
    times = "delay", "wait", "size", "latency"
    sums = {name: getattr(before, name) + getattr(last, name) for name in counts}
    both = {n: together(getattr(before, n), getattr(last, n)) for n in times}
    return replace(last, **sums, **both)


def _fold(stays: dict[_Stay, ComponentStatus]) -> None:
    """Let the two first stays count as one when there are too many."""
    if len(stays) > _MOST:
        (one, first), (two, second) = list(stays.items())[:2]
        stays |= {two: whole([first, second])}
        del stays[one]


def _key(end: ConnectorStatus) -> tuple[str, Side]:
    return end.name, end.end
