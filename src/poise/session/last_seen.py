"""What a run's statuses said last of all that ran, also of what is gone since."""

from __future__ import annotations

import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from typing import TypeVar

from msgspec.structs import asdict, replace

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

K = TypeVar("K")
N = TypeVar("N", TimerStatus, ChainStatus)
T = TypeVar("T", TimerStatus, ChainStatus, ConnectorStatus)
V = TypeVar("V")


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
        timers=_each_after(before.timers, last.timers, "releases", "missed"),
        chains=_each_after(before.chains, last.chains, "missed"),
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


def _each_after(before: Iterable[N], last: Iterable[N], *counts: str) -> tuple[N, ...]:
    known = {each.name: each for each in before}
    return tuple(
        _both(known[each.name], each, *counts) if each.name in known else each
        for each in last
    )


def _both(before: T, last: T, *counts: str) -> T:
    """Return the last record, with these counts and all summaries of both."""
    sums = {name: getattr(before, name) + getattr(last, name) for name in counts}
    summaries = {
        name: together(getattr(before, name), value)
        for name, value in asdict(last).items()
        if isinstance(value, Summary)
    }
    return replace(last, **sums, **summaries)


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
_Count = tuple[Place, int, str, int]
"""Where, in which process, of which incarnation, and the how many-th: an end that is
joined again counts from 0."""
_End = tuple[str, Side]
_MOST = 50
"""Up to this number of stays of a component are kept apart."""


class LastSeen:
    """Keeps what is gone: components that ended or moved, and their connectors."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._containers: dict[Place, ContainerStatus] = {}
        self._heard: dict[str, AgentStatus] = {}
        self._places: dict[str, Place] = {}
        self._stays: dict[str, dict[_Stay, ComponentStatus]] = {}
        self._ends: dict[_End, dict[_Count, ConnectorStatus]] = {}

    def record(self, statuses: Statuses) -> None:
        """Record what the agents say now."""
        for _, status in sorted(statuses.items()):
            self.record_status(status)

    def record_status(self, status: AgentStatus) -> None:
        """Record what an agent says, unless it said more since; any thread may."""
        with self._lock:
            heard = self._heard.get(status.computer, status)
            if heard.start == status.start and heard.uptime > status.uptime:
                return
            self._heard[status.computer] = status
            for container in status.containers:
                self._record_container(status.computer, container)

    def _record_container(self, computer: str, container: ContainerStatus) -> None:
        place = computer, container.name
        self._containers[place] = container
        for component in container.components:
            self._places[component.name] = place
            stays = self._stays.setdefault(component.name, {})
            stays[place, container.pid, component.epoch] = component
            _fold(stays, _after)
        # a source with two paths counts the same at both, but for what went out between
        ends = {(e.name, e.end, _epoch(e)): e for e in container.connectors}
        for (name, side, epoch), end in ends.items():
            counts = self._ends.setdefault((name, side), {})
            same = place, container.pid, epoch
            times = [count[-1] for count in counts if count[:-1] == same] or [0]
            known = counts.pop((*same, times[-1]), end)
            if known.count > end.count:
                counts[*same, times[-1]] = known
                times.append(times[-1] + 1)
            counts[*same, times[-1]] = end
            _fold(counts, _end_after)

    def merged(self, statuses: Statuses) -> Statuses:
        """Return the statuses, with what was there before and is gone."""
        self.record(statuses)
        containers: dict[str, list[ContainerStatus]] = defaultdict(list)
        with self._lock:
            for place, container in self._containers.items():
                containers[place[0]].append(self._latest(place, container))
        return {
            computer: replace(status, containers=tuple(containers[computer]))
            for computer, status in statuses.items()
        }

    def connectors(self) -> Iterator[ConnectorStatus]:
        """Yield each end of each connector, with the counts of all its stays."""
        with self._lock:
            for _, counts in sorted(self._ends.items()):
                yield reduce(_end_after, counts.values())

    def unprocessed(self, statuses: Statuses) -> dict[str, int]:
        """Return connector -> messages that were sent, and are not processed by now.

        What waited for a target that has moved, or rested, went on with it.
        """
        self.record(statuses)
        with self._lock:
            # a target that drops the oldest, as the end of its connectors' names
            keeping = tuple(
                f"-{name}.{port}"
                for name, stays in self._stays.items()
                for port in [*stays.values()][-1].keeps
            )
            sent: dict[tuple[str, _Count], int] = {}
            left: Counter[str] = Counter()
            for (name, side), counts in self._ends.items():
                if side != "target":  # both count on while the target comes or goes
                    for count, end in counts.items():
                        known = sent.get((name, count), 0)
                        sent[name, count] = max(known, end.messages)
                if side != "source":
                    keeps = name.endswith(keeping)
                    left[name] -= _num_taken(counts, drops=keeps or side == "target")
            for (name, _), messages in sent.items():
                left[name] += messages
        return dict(+left)

    def stays(self) -> Iterator[tuple[str, ComponentStatus]]:
        """Yield each component's last status in each place, with its computer."""
        for stays in self._stays.values():
            for ((computer, _), _, _), status in stays.items():
                yield computer, status

    def _latest(self, place: Place, container: ContainerStatus) -> ContainerStatus:
        here = (name for name, at in self._places.items() if at == place)
        components = tuple(whole(list(self._stays[name].values())) for name in here)
        ends = (
            reduce(_end_after, counts.values())
            for counts in self._ends.values()
            if [*counts][-1][0] == place
        )
        return replace(container, components=components, connectors=tuple(ends))


def _num_taken(counts: Mapping[_Count, ConnectorStatus], *, drops: bool) -> int:
    """Return how many messages were taken where they came to.

    Errors of a target that waits for messages are refusals.

    `drops`: whether what was dropped had gone out: in one container it had only where
    the target drops the oldest.
    """
    order, taken = [*counts], 0
    for now, after in zip(order, [*order[1:], order[-1]], strict=True):
        end = counts[now]
        processed = end.wait.count + end.errors + (end.drops if drops else 0)
        # of a container that ended by itself nothing went on
        is_lost = now[1] != after[1] and (now[0], now[2]) == (after[0], after[2])
        goes_on = now != after and not is_lost
        taken += max(processed, end.messages) if goes_on else processed
    return taken


def _end_after(before: ConnectorStatus, last: ConnectorStatus) -> ConnectorStatus:
    """Return an end's last status, with what it had counted in a process before."""
    counts = "calls", "messages", "bytes_out", "bytes_in", "errors", "drops"
    return _both(before, last, *counts)


def _fold(stays: dict[K, V], after: Callable[[V, V], V]) -> None:
    """Let the two first stays count as one when there are too many."""
    if len(stays) > _MOST:
        (one, first), (two, second) = list(stays.items())[:2]
        stays |= {two: after(first, second)}
        del stays[one]


def _epoch(end: ConnectorStatus) -> str:
    """Return which incarnation counts at an end: each goes on over others' moves."""
    source, _, target = end.key.rpartition("/")[2].partition(".")
    return target if end.end == "target" else source
