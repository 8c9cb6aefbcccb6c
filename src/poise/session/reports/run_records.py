"""What a run showed, as plain records, and what is read from statuses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from msgspec import Struct

from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    connectors_of,
    located,
)
from poise.manage.journal import JournalEntry
from poise.manage.observe.chains import ChainReport
from poise.manage.observe.troubles import refused
from poise.manage.tasks.concurrent_tasks import TaskReport
from poise.model.robot import Connector, Robot
from poise.session.reports.history import Moment
from poise.wire.records.heartbeat_records import ClockStatus
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ErrorCount,
    Fault,
    Summary,
    TimerStatus,
)


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
            component=component.name,
            computer=computer,
            where=error.where,
            text=error.text,
            first=error.first,
            count=error.count,
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
        count = end.messages + end.calls
        if end.end != "source":
            came[end.name] = came.get(end.name, 0) + count
        if end.end != "target":
            sent[end.name] = max(sent.get(end.name, 0), count)
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


class RunRecord(Struct, frozen=True, kw_only=True):
    """What a run showed; `RunReport` prints it and describes its fields."""

    robot: str
    task: str
    method: str
    placement: Mapping[str, str]
    decision_seconds: float
    seconds: float
    cpu_share: Mapping[str, float]
    components: tuple[ComponentReport, ...]
    connectors: tuple[ConnectorStatus, ...]
    began: float = 0.0
    history: tuple[Moment, ...] = ()
    journal: tuple[JournalEntry, ...] = ()
    chains: tuple[ChainReport, ...] = ()
    tasks: tuple[TaskReport, ...] = ()
    put_aside: tuple[str, ...] = ()
    errors: tuple[ComponentError, ...] = ()
    hung: tuple[HungHandler, ...] = ()
    refused: Mapping[str, int] = {}
    lost: Mapping[str, int] = {}
    silent: tuple[SilentPort, ...] = ()
    faults: tuple[Fault, ...] = ()
    interrupted: bool = False
    clocks: Mapping[str, Mapping[str, ClockStatus]] = {}
    invalid: str = ""
    without: tuple[str, ...] = ()
    simulation: Mapping[str, Any] = {}

    def component(self, name: str) -> ComponentReport:
        """Return the report of one component; KeyError when it did not run."""
        for component in self.components:
            if component.name == name:
                return component
        raise KeyError(name)

    @property
    def failed(self) -> bool:
        """Whether code raised or hung, a message was refused, or not all ran."""
        return bool(
            self.errors
            or self.hung
            or self.refused
            or self.faults
            or self.put_aside
            or any(each.state == "failed" for each in self.tasks)
        )


def component_reports(begin: Statuses, end: Statuses) -> tuple[ComponentReport, ...]:
    """Return a report for every component in the last statuses."""
    before = {each.name: each.cpu for each in components_of(begin)}
    return tuple(
        ComponentReport(
            name=component.name,
            computer=computer,
            cpu=max(0.0, component.cpu - before.get(component.name, 0.0))
            / _seconds(begin.get(computer), end[computer]),
            errors=component.errors,
            timers=component.timers,
            measures=component.measures,
        )
        for computer, component in located(end)
    )


def _seconds(first: AgentStatus | None, last: AgentStatus) -> float:
    """Return the time between two statuses of a computer [s]."""
    return last.uptime - (first.uptime if first else 0.0) or math.inf


def clocks_of(statuses: Statuses) -> dict[str, Mapping[str, ClockStatus]]:
    """Return what each computer knows of the others' clocks, by name."""
    return {name: status.clocks for name, status in sorted(statuses.items())}
