"""What went wrong in a run, so far as components' code and messages are concerned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from msgspec import Struct

from poise.manage.statuses import components_of
from poise.wire.records.deployment import AgentStatus, ErrorCount

Statuses = Mapping[str, AgentStatus]


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


def component_errors(statuses: Statuses) -> tuple[ComponentError, ...]:
    """Return all that components raised, in the order in which it first came."""
    found = [
        ComponentError(
            component=component.name,
            computer=computer,
            where=error.where,
            text=error.text,
            first=error.first,
            count=error.count,
        )
        for computer, status in statuses.items()
        for component in components_of({computer: status})
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
        for computer, status in statuses.items()
        for component in components_of({computer: status})
        if component.handler and component.state == "active"
    )


def refused_messages(statuses: Statuses) -> dict[str, int]:
    """Return connector -> messages that its target refused: not of the port's type."""
    found: Counter[str] = Counter()
    for status in statuses.values():
        for container in status.containers:
            topics = tuple(
                f"-{component.name}.{port}"
                for component in container.components
                for port in component.subscribes
            )
            for end in container.connectors:
                if end.end != "source" and end.errors and end.name.endswith(topics):
                    found[end.name] += end.errors
    return dict(found)
