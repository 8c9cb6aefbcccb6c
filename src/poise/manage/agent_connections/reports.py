"""What agents reported, each and together, and which of them are there.

zenoh's threads only store what arrives, in structures whose size is bounded; the
manager's own threads wait for it here.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, TypeVar

import msgspec
import zenoh

from poise.clock import Clock, wall_time
from poise.errors import RunError
from poise.wire.codec import MALFORMED
from poise.wire.control_session import IDENTITIES, parse_identity
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
)

if TYPE_CHECKING:
    from poise.manage.deploy.desired import Incarnation

Statuses = Mapping[str, AgentStatus]
"""Computer -> what its agent reported last."""

CUT = 0.7
"""A link over which no heartbeat came for so long is cut [s]."""
_WORKING = {
    "unconfigured": " (do its import and `configure` end?)",
    "inactive": " (does its `activate` end?)",
}
"""What may keep a component in a state."""


def components_of(statuses: Statuses) -> Iterator[ComponentStatus]:
    """Yield the components in all statuses, by computer."""
    for _, status in sorted(statuses.items()):
        yield from status.components


def located(statuses: Statuses) -> Iterator[tuple[str, ComponentStatus]]:
    """Yield the components in all statuses with their computers, by computer."""
    for computer, status in sorted(statuses.items()):
        for component in status.components:
            yield computer, component


def calling_ports(statuses: Statuses) -> set[tuple[str, str]]:
    """Return the ends over which components call: component and port."""
    return {(c.name, port) for c in components_of(statuses) for port in c.requires}


def keeping_ports(statuses: Statuses) -> dict[tuple[str, str], int]:
    """Return component and port -> how many messages it keeps; it may lose others."""
    return {
        (component.name, port): size
        for component in components_of(statuses)
        for port, size in component.keeps.items()
    }


def cut_links(statuses: Statuses) -> set[frozenset[str]]:
    """Return the pairs of computers of which one does not hear the other."""
    return {
        frozenset((here, there))
        for here, status in statuses.items()
        for there, link in status.links.items()
        if link.silent > CUT
    }


def unresponsive_containers(statuses: Statuses) -> dict[tuple[str, str], str]:
    """Return computer and container -> why it does not respond."""
    return {
        (computer, health.name): health.reason
        for computer, status in statuses.items()
        for health in status.health
        if health.state == "unresponsive"
    }


def gateways(statuses: Statuses) -> dict[str, str]:
    """Return where other computers reach each computer's containers."""
    return {name: status.gateway for name, status in statuses.items()}


def connectors_of(statuses: Statuses) -> Iterator[ConnectorStatus]:
    """Yield the connector ends in all statuses."""
    for status in statuses.values():
        for container in status.containers:
            yield from container.connectors


def missing(
    wanted: Iterable[Incarnation],
    statuses: Statuses,
    silent: Iterable[str],
    joins: Collection[str],
) -> list[str]:
    """Return what is not yet as it is wanted, in words; nothing when all is."""
    states = {(c.name, c.epoch): c.state for c in components_of(statuses)}
    found = [f"computer '{name}' is silent" for name in sorted(silent)]
    found += [
        f"component '{incarnation.component}' on '{incarnation.computer}' is {state}, "
        f"not yet {incarnation.goal}{_WORKING.get(state, '')}"
        for incarnation in wanted
        if (
            state := states.get((incarnation.component, incarnation.epoch), "not there")
        )
        != incarnation.goal
    ]
    found += [
        f"connector '{connector.name}' is not joined"
        for connector in connectors_of(statuses)
        if not connector.ready and connector.key in joins
    ]
    return found


def containers_left(statuses: Statuses, computers: Iterable[str]) -> list[str]:
    """Return the containers that may still run on computers, in words."""
    left = sorted(computers)
    return [f"everything on '{name}'" for name in left if name not in statuses] + [
        f"container '{container.name}' on '{name}'"
        for name in left
        if name in statuses
        for container in statuses[name].containers
    ]


def unreached(
    out_of_reach: Mapping[str, float],
    placement: Mapping[str, str],
    heard_by: Mapping[str, str],
    leased: Collection[str],
) -> dict[str, str]:
    """Return what is known of each computer that is out of reach, in words."""
    sentences = {}
    for computer, since in sorted(out_of_reach.items()):
        began = time.strftime("%H:%M:%S", time.localtime(since))
        sentences[computer] = (
            f"computer '{computer}' has been out of reach since {began}"
        )
        inside = sorted(name for name, at in placement.items() if at == computer)
        other = heard_by.get(computer)
        if inside and other:
            names = ", ".join(inside)
            sentences[computer] += f"; '{other}' still reaches it: {names} keep running"
            continue
        stop = ", ".join(name for name in inside if name in leased)
        stay = ", ".join(name for name in inside if name not in leased)
        if stop:
            sentences[computer] += f"; {stop} stops there when its lease ends"
        if stay:
            sentences[computer] += f"; {stay} may still run there"
    return sentences


S = TypeVar("S")

MOST_REFUSED = 100
"""At most this many different sentences about refused records are kept."""


class AgentReports:
    """What the agents of one robot reported last. Any thread may ask."""

    def __init__(self, robot: str, endpoints: Mapping[str, str], clock: Clock) -> None:
        self._robot = robot
        self._endpoints = endpoints
        self._clock = clock
        self._identities: dict[str, tuple[str, str]] = {}
        self._changed = threading.Condition()
        self._version = 0
        self._statuses: dict[str, AgentStatus] = {}
        self._heard: dict[str, float] = {}
        self._alive: set[str] = set()
        self._lost: dict[str, float] = {}
        self._silent: dict[str, float] = {}
        self._seen = dict(self._statuses), {**self._silent, **self._lost}
        """What any thread may read without the lock: replaced, and never changed."""
        self._refused: list[str] = []
        self._num_taken = 0
        self.on_status: Callable[[AgentStatus], object] = lambda _: None

    def subscribe(self, session: zenoh.Session) -> list[object]:
        """Store from now on what agents report; return what must be kept for that."""
        prefix, liveliness = f"poise/{self._robot}", session.liveliness()
        return [
            session.declare_subscriber(
                f"{prefix}/status/*",
                reading(AgentStatus, self.take_status, self.on_refused),
            ),
            liveliness.declare_subscriber(
                f"{prefix}/alive/*", self.on_alive, history=True
            ),
            liveliness.declare_subscriber(IDENTITIES, self.on_identity, history=True),
        ]

    def statuses(self) -> Mapping[str, AgentStatus]:
        """Return what each agent reported last, by computer."""
        return self._seen[0]

    def ages(self) -> dict[str, float]:
        """Return how long ago each agent reported last [s], by computer."""
        now = self._clock.now()
        with self._changed:
            return {name: now - self._heard[name] for name in self._statuses}

    def out_of_reach(self) -> Mapping[str, float]:
        """Return since when [s since 1970] agents that were there are not reached."""
        return self._seen[1]

    def reached(self) -> set[str]:
        """Return the computers whose agents are there and have reported."""
        with self._changed:
            return (self._alive & self._statuses.keys()) - self._silent.keys()

    def wait_news(self, is_enough: Callable[[], bool], limit: float) -> bool:
        """Wait [s] until `is_enough`, evaluated at all news; return whether it is."""
        deadline = self._clock.now() + limit
        while True:
            with self._changed:
                version = self._version
            # without the lock, for which zenoh's threads would wait
            if is_enough():
                return True
            left = deadline - self._clock.now()
            with self._changed:
                if left <= 0 or not self._changed.wait_for(
                    lambda seen=version: self._version != seen,  # type: ignore[misc]
                    left,
                ):
                    return False

    def notify(self) -> None:
        """Let every `wait_news` evaluate again."""
        with self._changed:
            self._note_news()

    def raise_on_other_agents(self, missing: Iterable[str]) -> None:
        """Raise RunError when others than the agents of `missing` are there."""
        others = []
        for computer in sorted(missing):
            locator = self._endpoints[computer]
            found = self._identities.get(locator, (self._robot, computer))
            if found != (self._robot, computer):
                others.append(
                    f"at {locator.removeprefix('tcp/')} there is the agent of computer "
                    f"'{found[1]}' of robot '{found[0]}', not of computer '{computer}' "
                    f"of robot '{self._robot}'"
                )
        if others:
            raise RunError("; ".join(others))

    def take_refused(self) -> list[str]:
        """Return new reasons why records were refused, each once."""
        with self._changed:
            new = self._refused[self._num_taken :]
            self._num_taken = len(self._refused)
            return new

    def on_refused(self, sentence: str) -> None:
        """Store why a record was refused."""
        with self._changed:
            is_known = sentence in self._refused
            if not is_known and len(self._refused) < MOST_REFUSED:
                self._refused.append(sentence)
                self._note_news()

    def take_status(self, status: AgentStatus) -> None:
        """Store what an agent reported."""
        if status.computer not in self._endpoints:
            return
        self.on_status(status)
        with self._changed:
            self._statuses[status.computer] = status
            self._heard[status.computer] = self._clock.now()
            self._note_news()

    def on_identity(self, sample: zenoh.Sample) -> None:
        """Store which agent is at an address."""
        locator, robot, computer = parse_identity(str(sample.key_expr))
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._identities[locator] = robot, computer
            elif self._identities.get(locator) == (robot, computer):
                del self._identities[locator]

    def _on_new_agent(self, computer: str) -> None:
        """Know nothing of the agent of a computer that is back."""

    def _on_ended_agent(self, computer: str) -> None:
        """Note that an agent is gone now, so far as is known."""

    def on_alive(self, sample: zenoh.Sample) -> None:
        """Store that an agent came or went."""
        computer = str(sample.key_expr).rpartition("/")[2]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(computer)
                if self._lost.pop(computer, None) is not None:
                    # it may be another agent: what this one reports is to come
                    self._statuses.pop(computer, None)
                    self._silent.pop(computer, None)
                    self._on_new_agent(computer)
            elif computer in self._alive:
                self._alive.discard(computer)
                self._lost[computer] = wall_time()
                self._on_ended_agent(computer)
            self._note_news()

    def on_silent(self, computers: Iterable[str]) -> None:
        """Store whose heartbeats do not come."""
        with self._changed:
            now = wall_time()
            self._silent = {c: self._silent.get(c, now) for c in computers}
            self._note_news()

    def go_on_without_missing(self) -> None:
        """Count agents that are not there as lost."""
        with self._changed:
            missing = self._endpoints.keys() - self._alive
            self._lost |= dict.fromkeys(missing, wall_time())
            for computer in missing:
                self._on_ended_agent(computer)
            self._note_news()

    def _note_news(self) -> None:
        self._seen = dict(self._statuses), {**self._silent, **self._lost}
        self._version += 1
        self._changed.notify_all()


def reading(
    type_: type[S], take: Callable[[S], object], refuse: Callable[[str], object]
) -> Callable[..., None]:
    """Return what takes the records of a type from agents, and refuses others."""
    decode = msgspec.msgpack.Decoder(type_).decode

    def hear(sample: zenoh.Sample) -> None:
        try:
            record = decode(sample.payload.to_bytes())
        except MALFORMED as error:
            refuse(f"a record at {sample.key_expr} was refused: {error}")
        else:
            take(record)

    return hear
