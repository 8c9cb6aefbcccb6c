"""What there is to see of a running robot, in rows: for `top` and whatever shows more.

Differences of a status's totals over the last seconds make rates, on the time of each
container, so that nothing on the way distorts them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError
from poise.session.running_robots.running import (
    ChainReport,
    JournalEntry,
    Running,
    Status,
)
from poise.wire.records.status_records import (
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
)

P = TypeVar("P")
SPAN = 3.0
"""Rates are means over this time [s]."""


class ComputerRow(Struct, frozen=True):
    """A computer: `cpu` [cores] and `memory` [bytes] of their capacities.

    Other programs count in `cpu`, where their use is known, not in `memory`. None: it
    is not known.
    """

    name: str
    cpu: float | None
    cores: float
    memory: float | None
    most_memory: float
    components: int
    is_reached: bool
    age: float | None = None  # of the last news [s]


class ComponentRow(Struct, frozen=True):
    """A component: `cpu` [cores], deadlines missed [1/s], and errors so far.

    What is not known now is None.
    """

    name: str
    computer: str
    state: str
    cpu: float | None
    missed: float | None
    errors: int


class ConnectorRow(Struct, frozen=True):
    """A connector: messages and calls [1/s], traffic [bytes/s], drops and errors.

    Where no end is known now, the kind is empty, and rate and traffic are None.
    """

    name: str
    kind: str
    is_joined: bool
    rate: float | None
    traffic: float | None
    drops: int
    errors: int


class TimerRow(Struct, frozen=True):
    """A timer with a deadline [s]: releases and missed deadlines [1/s].

    What is not known now is None.
    """

    name: str
    component: str
    computer: str
    deadline: float
    rate: float | None
    missed: float | None


class ChainRow(Struct, frozen=True):
    """How old the data of a chain was when it was used [s], and how often too old.

    Both ages are None while it was not used. `late` is the share of its uses lately
    that was too old; None: there was no use, or it is not known.
    """

    name: str
    median: float | None
    p99: float | None
    deadline: float
    missed: int
    late: float | None


class RobotView(Struct, frozen=True):
    """A running robot at one moment: its status, and rows made of it."""

    status: Status
    computers: tuple[ComputerRow, ...]
    components: tuple[ComponentRow, ...]
    connectors: tuple[ConnectorRow, ...]
    timers: tuple[TimerRow, ...]
    chains: tuple[ChainRow, ...]


class Reader:
    """Turns statuses, as they come, into what is shown."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, Status]] = deque()

    def update(self, status: Status, now: float) -> RobotView:
        """Return what is to be seen of a status that came at `now` [s]."""
        self._past.append((now, status))
        while len(self._past) > 2 and self._past[1][0] <= now - SPAN:  # noqa: PLR2004
            self._past.popleft()
        before = self._past[0][1]
        return RobotView(
            status=status,
            computers=tuple(_computers(status)),
            components=tuple(_components(before, status)),
            connectors=tuple(_connectors(before, status)),
            timers=tuple(_timers(before, status)),
            chains=tuple(_chains(before, status)),
        )


def _computers(status: Status) -> Iterator[ComputerRow]:
    unknown = status.not_known()
    for name in sorted({*status.computers, *status.capacities, *unknown}):
        agent, capacity = status.computers.get(name), status.capacities.get(name, {})
        is_known = agent is not None and name not in unknown
        yield ComputerRow(
            name,
            agent.load + (status.background(name) or 0) if agent and is_known else None,
            capacity.get("cpu", 0.0),
            agent.memory if agent and is_known else None,
            capacity.get("memory", 0.0),
            sum(there == name for there in status.placement.values()),
            name not in unknown,
            status.ages.get(name),
        )


def _components(before: Status, now: Status) -> Iterator[ComponentRow]:
    seen, unknown = set(), now.not_known()
    for computer, component, was, seconds in _components_since(before, now):
        if computer in unknown and now.placement.get(component.name) != computer:
            continue  # it is meant to run elsewhere, and nobody knows of this one
        seen.add(component.name)
        yield ComponentRow(
            component.name,
            computer,
            component.state if computer not in unknown else "unknown",
            _rate(component.cpu, was.cpu, seconds),
            _rate(component.missed, was.missed, seconds),
            component.errors,
        )
    for name in sorted(now.placement.keys() - seen):
        state = "unknown" if now.placement[name] in unknown else "not there"
        yield ComponentRow(name, now.placement[name], state, None, None, 0)


def _connectors(before: Status, now: Status) -> Iterator[ConnectorRow]:
    """Yield each connector as its source counts it, and what both ends gave up."""
    unknown = now.not_known()
    ends: dict[str, list[tuple[bool, ConnectorStatus, ConnectorStatus, _Span]]] = {}
    seen = _since(before, now, lambda c: c.connectors, lambda end: (end.name, end.end))
    for computer, end, was, seconds in seen:
        is_known = computer not in unknown
        ends.setdefault(end.name, []).append((is_known, end, was, seconds))
    for name, both in sorted(ends.items()):
        known = [pair for pair in both if pair[0]]
        _, source, was, seconds = min(known or both, key=lambda e: e[1].end == "target")
        yield ConnectorRow(
            name,
            source.kind if known else "",
            all(end.ready for _, end, _, _ in known),
            _rate(source.count, was.count, seconds),
            _rate(_traffic(source), _traffic(was), seconds),
            sum(end.drops for _, end, _, _ in both),
            sum(end.errors for _, end, _, _ in both),
        )


def _timers(before: Status, now: Status) -> Iterator[TimerRow]:
    for computer, component, was, seconds in _components_since(before, now):
        earlier = {timer.name: timer for timer in was.timers}
        for timer in component.timers:
            if timer.deadline is None:
                continue
            first = earlier.get(timer.name, timer)
            yield TimerRow(
                f"{component.name}.{timer.name}",
                component.name,
                computer,
                timer.deadline,
                _rate(timer.releases, first.releases, seconds),
                _rate(timer.missed, first.missed, seconds),
            )


def _chains(before: Status, now: Status) -> Iterator[ChainRow]:
    """Yield each chain; what moved counts from 0 again."""
    earlier = {_incarnation(chain): chain for chain in before.chains}
    for chain in now.chains:
        was, age = earlier.get(_incarnation(chain), chain), chain.age
        used = age.count - was.age.count
        is_known = not {hop.computer for hop in chain.hops} & now.not_known()
        late = (chain.missed - was.missed) / used if is_known and used > 0 else None
        median, p99 = (age.median, age.p99) if age.count else (None, None)
        yield ChainRow(chain.name, median, p99, chain.deadline, chain.missed, late)


def _incarnation(chain: ChainReport) -> tuple[str, tuple[int, ...]]:
    return chain.name, tuple(hop.epoch for hop in chain.hops)


_Span = float | None
"""The time between two looks [s]; None: nothing can be said of it."""


def _rate(now: float, before: float, seconds: _Span) -> float | None:
    return None if seconds is None else max(0, now - before) / seconds


def _components_since(
    before: Status, now: Status
) -> Iterator[tuple[str, ComponentStatus, ComponentStatus, _Span]]:
    return _since(before, now, lambda c: c.components, lambda each: each.key)


def _since(
    before: Status,
    now: Status,
    parts: Callable[[ContainerStatus], Iterable[P]],
    key_of: Callable[[P], object],
) -> Iterator[tuple[str, P, P, _Span]]:
    """Yield where each part of containers is, it, how it was, and the time since."""
    past, unknown = dict(containers(before)), now.not_known()
    for key, container in containers(now):
        first = past.get(key)
        seconds = container.at - first.at if first else 0.0
        earlier = {key_of(part): part for part in parts(first)} if first else {}
        for part in parts(container):
            was = earlier.get(key_of(part))
            is_known = was is not None and seconds > 0 and key.computer not in unknown
            yield key.computer, part, was or part, seconds if is_known else None


class _Key(NamedTuple):
    """One start of a container."""

    computer: str
    container: str
    pid: int


def containers(status: Status) -> Iterator[tuple[_Key, ContainerStatus]]:
    """Yield the containers of a robot, and where they are."""
    for computer, agent in sorted(status.computers.items()):
        for container in agent.containers:
            yield _Key(computer, container.name, container.pid), container


def _traffic(end: ConnectorStatus) -> int:
    return end.bytes_in + end.bytes_out


MOST_ENTRIES = 500
"""How many decisions are kept."""


class LiveReading(Struct, frozen=True, kw_only=True):
    """How a robot was when it was last looked at."""

    at: float = 0.0  # When it was looked at [s since 1970]
    # What was known last, of agents if no manager answers; None: nothing yet
    status: Status | None = None
    # The last entries of its journal, oldest first
    entries: tuple[JournalEntry, ...] = ()
    trouble: str = ""  # Why no manager answers now; empty: one does
    since: float = 0.0  # Since when there is none [s since 1970]
    is_old: bool = False  # Whether no agent answers, either: it is as it was before


class LiveReader:
    """Reads one robot. It looks only when it is asked to, and never raises."""

    def __init__(self, robot: str | None = None) -> None:
        self.running = Running(robot)
        self._entries: deque[JournalEntry] = deque(maxlen=MOST_ENTRIES)
        self._seen = LiveReading()

    def poll(self) -> LiveReading:
        """Return how the robot is; without an answer, how it was, and why."""
        before = self._seen
        try:
            status = self.running.status()
            self.running.name = status.robot
            if before.status is None or before.status.manager != status.manager:
                # its journal may be another file, with numbers of its own
                self._entries.clear()
            seen = LiveReading(status=status)
            if status.by_agents:  # the journal is the manager's
                first = status.deviations[0]
                seen = replace(seen, trouble=first.what, since=first.since)
            else:
                after = self._entries[-1].number if self._entries else 0
                self._entries.extend(self.running.journal(after))
        except PoiseError as error:
            since = before.since if before.trouble else wall_time()
            seen = replace(before, trouble=str(error), since=since, is_old=True)
        self._seen = replace(seen, entries=tuple(self._entries), at=wall_time())
        return self._seen
