"""What the statuses of all agents say together. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING

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
    """Return the components in all statuses, by computer."""
    return chain.from_iterable([s.components for _, s in sorted(statuses.items())])


def located(statuses: Statuses) -> Sequence[tuple[str, ComponentStatus]]:
    """Return the components in all statuses with their computers, by computer."""
    return [
        (computer, component)
        for computer, status in sorted(statuses.items())
        for component in status.components
    ]


def calling_ports(statuses: Statuses) -> set[tuple[str, str]]:
    """Return the ends over which components call: component and port."""
    return {(c.name, port) for c in components_of(statuses) for port in c.requires}


def keeping_ports(statuses: Statuses) -> dict[tuple[str, str], int]:
    """Return component and port -> how many messages it keeps; it may lose others."""
    return {
        (c.name, port): size
        for c in components_of(statuses)
        for port, size in c.keeps.items()
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
    """Return the connector ends in all statuses."""
    containers = chain.from_iterable([s.containers for s in statuses.values()])
    return chain.from_iterable([container.connectors for container in containers])


def not_at_goals(
    wanted: Iterable[Incarnation], statuses: Statuses, silent: Iterable[str]
) -> list[str]:
    """Return what is not yet in the state that is wanted, in words."""
    states = {c.key: c.state for c in components_of(statuses)}
    found = [f"computer '{name}' is silent" for name in sorted(silent)]
    found += [
        f"component '{incarnation.component}' on '{incarnation.computer}' is "
        + (f"{state}, not yet {incarnation.goal}" if state else "not there yet")
        + _WORKING.get(state, "")
        for incarnation in wanted
        if (state := states.get(incarnation.key, "")) != incarnation.goal
    ]
    return found


def not_joined(statuses: Statuses, between: Mapping[str, tuple[str, str]]) -> list[str]:
    """Return which connectors are not joined at an end, in words.

    `between`: the keys of those that should be -> the computers of their two ends.
    """
    sentences = [
        why_not_joined(connector, *between[connector.key], statuses)
        for connector in connectors_of(statuses)
        if not connector.ready and connector.key in between
    ]
    return [*dict.fromkeys(sentences)]


def why_not_joined(
    end: ConnectorStatus, source: str, target: str, statuses: Statuses
) -> str:
    """Return which connector is not joined, and where that can be looked into."""
    what = f"connector '{end.name}' from '{source}' does not reach '{target}'"
    status = statuses.get(target)
    if source != target and status is not None and status.gateway:
        what += f" at {status.gateway} (TCP)"
    return f"{what}: {end.refusal}" if end.refusal else what


def containers_left(statuses: Statuses, computers: Iterable[str]) -> list[str]:
    """Return the containers that may still run on computers, in words."""
    left = sorted(computers)
    return [f"everything on '{name}'" for name in left if name not in statuses] + [
        f"container '{container.name}' on '{name}'"
        for name in left
        if name in statuses
        for container in statuses[name].containers
    ]
