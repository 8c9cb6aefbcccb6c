"""What a run showed, as plain records: its moments, and what is read from statuses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping

from msgspec import Struct, structs

from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    connectors_of,
    located,
)
from poise.manage.observe.chains import ChainAges, DeadlineMisses, chain_reports
from poise.manage.observe.troubles import refused
from poise.model.robot import Connector, Robot
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ErrorCount,
    Summary,
    TimerStatus,
)

MOST = 2_000
"""The most moments; of a longer run every second one is dropped, again and again."""


class Moment(Struct, frozen=True, kw_only=True):
    """Shares of CPU used and of deadlines missed in the second before a time."""

    at: float
    cpu_share: Mapping[str, float]
    missed: Mapping[str, float]


class History:
    """Takes a moment of a run every second, of computers `faster` than described."""

    def __init__(self, robot: Robot, faster: Mapping[str, float]) -> None:
        self.moments: list[Moment] = []
        self._robot, self._faster = robot, faster
        self._timers, self._chains = DeadlineMisses(), ChainAges()
        self._before: Statuses = {}
        self._every, self._next = 1.0, 0.0

    def record(self, statuses: Statuses, at: float, now: float) -> None:
        """Take a moment when it is time: `at` since 1970, `now` never goes back [s]."""
        if now < self._next:
            return
        self._next = now + self._every
        timers = self._timers.measure(statuses, now)
        chains = self._chains.measure(chain_reports(self._robot, statuses), now)
        missed = {t.name: t.share for t in timers if t.missed}
        missed |= {c.chain: c.missed / c.used for c in chains if c.missed}
        shares = cpu_shares(self._robot, self._before, statuses, self._faster)
        self._before = dict(statuses)
        self.moments.append(Moment(at=at, cpu_share=shares, missed=missed))
        if len(self.moments) > MOST:
            del self.moments[::2]
            self._every *= 2


def cpu_shares(
    robot: Robot, begin: Statuses, end: Statuses, faster: Mapping[str, float]
) -> dict[str, float]:
    """Return computer -> share of its CPU used between two statuses."""
    shares = {}
    for computer in robot.computers:
        first, last = begin.get(computer.name), end.get(computer.name)
        if first is None or last is None:
            continue
        if first.start != last.start:  # its agent was started again, and counts from 0
            first = structs.replace(first, cpu=0.0, uptime=0.0)
        if last.uptime <= first.uptime:
            continue
        cores = (last.cpu - first.cpu) / (last.uptime - first.uptime)
        has = computer.own_cores * faster.get(computer.name, 1)
        shares[computer.name] = cores / has
    return shares


class ComponentError(ErrorCount, frozen=True, kw_only=True):
    """Errors of one type that one line of a component's code raised."""

    component: str
    computer: str


class HungHandler(Struct, frozen=True, kw_only=True):
    """A timer's or port's code that still ran, for `seconds`, when the run was over."""

    component: str
    computer: str
    handler: str
    seconds: float


def component_errors(
    located: Iterable[tuple[str, ComponentStatus]],
) -> tuple[ComponentError, ...]:
    """Return all that components on their computers raised, the first first."""
    found = [
        ComponentError(
            component=component.name, computer=computer, **structs.asdict(error)
        )
        for computer, component in located
        for error in component.error_counts
    ]
    return tuple(sorted(found, key=lambda error: error.first))


def hung_handlers(statuses: Statuses) -> tuple[HungHandler, ...]:
    """Return the handlers that kept components from being deactivated."""
    return tuple(
        HungHandler(
            component=component.name,
            computer=computer,
            handler=component.handler,
            seconds=component.handler_seconds,
        )
        for computer, component in located(statuses)
        if component.handler and component.state == "active"
    )


def refused_messages(statuses: Statuses) -> dict[str, int]:
    """Return connector -> messages that its target refused: not of the port's type."""
    found: Counter[str] = Counter()
    for status in statuses.values():
        for container in status.containers:
            found += Counter(dict(refused(container)))
    return dict(found)


class SilentPort(Struct, frozen=True, kw_only=True):
    """A port, as component.port, that got no message or no call, and why."""

    port: str
    reason: str

    def __str__(self) -> str:
        """Return it as a sentence."""
        return f"port {self.port} got no message: {self.reason}"


def silent_ports(
    robot: Robot, statuses: Statuses, also: Iterable[str] = ()
) -> tuple[SilentPort, ...]:
    """Return subscribed ports, and of `also` provided ones, to which nothing came."""
    running = {component.name for component in components_of(statuses)}
    came: dict[str, int] = {}
    sent: dict[str, int] = {}
    for end in connectors_of(statuses):
        if end.end != "source":
            came[end.name] = came.get(end.name, 0) + end.count
        if end.end != "target":
            sent[end.name] = max(sent.get(end.name, 0), end.count)
    topics = [f"{c.name}.{p}" for c in components_of(statuses) for p in c.subscribes]
    found = []
    for name in dict.fromkeys([*topics, *also]):
        leads = [c for c in robot.all_connectors() if str(c.between[1]) == name]
        if not any(came.get(str(connector)) for connector in leads):
            reasons = [_reason(connector, running, sent) for connector in leads]
            reason = "; ".join(reasons) or "no connector leads to it"
            found.append(SilentPort(port=name, reason=reason))
    return tuple(found)


def _reason(connector: Connector, running: set[str], sent: Mapping[str, int]) -> str:
    source = connector.between[0]
    if source.component not in running:
        return f"component '{source.component}', which publishes to it, does not run"
    count = sent.get(str(connector), 0)
    if not count:
        return f"{source} published nothing"
    return f"{source} published {count}, and none arrived"


class ComponentReport(Struct, frozen=True, kw_only=True):
    """How a component did in all its places; `cpu` is of its own thread [cores]."""

    name: str
    computer: str
    cpu: float
    errors: int
    timers: tuple[TimerStatus, ...]
    measures: Mapping[str, Summary]


def component_reports(
    begin: Statuses, end: Statuses, seconds: float
) -> tuple[ComponentReport, ...]:
    """Return a report for every component in the last statuses, `seconds` later."""
    before = {each.name: each.cpu for each in components_of(begin)}
    return tuple(
        ComponentReport(
            name=component.name,
            computer=computer,
            cpu=max(0.0, component.cpu - before.get(component.name, 0.0))
            / _seconds(begin.get(computer), end[computer], seconds),
            errors=component.errors,
            timers=component.timers,
            measures=component.measures,
        )
        for computer, component in located(end)
    )


def _seconds(first: AgentStatus | None, last: AgentStatus, about: float) -> float:
    """Return the time between two statuses of a computer [s], `about` so long."""
    if first is not None and first.start != last.start:
        return about  # its agent was started again, and counts from 0
    return last.uptime - (first.uptime if first else 0.0) or math.inf
