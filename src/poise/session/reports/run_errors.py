"""What went wrong in a run with components' code and messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from msgspec import Struct

from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    connectors_of,
    located,
)
from poise.manage.observe.troubles import refused
from poise.model.robot import Connector, Robot
from poise.wire.records.status_records import ComponentStatus, ErrorCount


class ComponentError(ErrorCount, frozen=True, kw_only=True):
    """Errors of one type that one line of a component's code raised."""

    component: str
    computer: str


class HungHandler(Struct, frozen=True, kw_only=True):
    """A timer's or port's code that still ran when the run was over.

    `seconds` is for how long already [s].
    """

    component: str
    computer: str
    handler: str
    seconds: float


def component_errors(
    located: Iterable[tuple[str, ComponentStatus]],
) -> tuple[ComponentError, ...]:
    """Return all that components raised, in the order in which it first came.

    Parameters
    ----------
    located
        Computers and what their components said last.
    """
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
    """A port that got no message, or no call.

    Parameters
    ----------
    port
        As component.port.
    reason
        Why, so far as it is known, for people.
    """

    port: str
    reason: str

    def __str__(self) -> str:
        """Return it as a sentence."""
        return f"port {self.port} got no message: {self.reason}"


def silent_ports(
    robot: Robot, statuses: Statuses, also: Iterable[str] = ()
) -> tuple[SilentPort, ...]:
    """Return the subscribed ports to which no message came since the start.

    Parameters
    ----------
    also
        Provided ports, as component.port, to which no call may have come.
    """
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
