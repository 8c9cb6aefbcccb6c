"""What a run's statuses said last of all that ran, also of what is gone since."""

from __future__ import annotations

from typing import TypeVar

from msgspec.structs import replace

from poise.manage.agent_connections.statuses import Statuses, located
from poise.wire.records.status import (
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
)

Place = tuple[str, str]
"""Computer and container."""


class LastSeen:
    """Keeps what is gone: components of actions that are over, and their connectors.

    Where something was in several places, only the latest counts.

    Attributes
    ----------
    ended
        What ends of connectors had counted when their container ended and another one
        took its place; those began at 0.
    """

    def __init__(self) -> None:
        self._containers: dict[Place, ContainerStatus] = {}
        self._components: dict[str, str] = {}
        self._ends: dict[tuple[str, str], Place] = {}
        self.ended: list[ConnectorStatus] = []

    def look(self, statuses: Statuses) -> None:
        """Take what the agents say now; call it a few times a second."""
        for computer, component in located(statuses):
            self._components[component.name] = computer
        for computer, status in statuses.items():
            for container in status.containers:
                place = computer, container.name
                before = self._containers.get(place)
                if before is not None and before.pid != container.pid:
                    self.ended += (
                        end
                        for end in before.connectors
                        if self._ends[end.name, end.end] == place
                    )
                self._containers[place] = _with(container, before)
                for end in container.connectors:
                    self._ends[end.name, end.end] = place

    def merged(self, statuses: Statuses) -> Statuses:
        """Return the statuses, with what was there before and is gone."""
        self.look(statuses)
        return {
            computer: replace(
                status,
                containers=tuple(
                    self._latest(place, container)
                    for place, container in self._containers.items()
                    if place[0] == computer
                ),
            )
            for computer, status in statuses.items()
        }

    def _latest(self, place: Place, container: ContainerStatus) -> ContainerStatus:
        return replace(
            container,
            components=tuple(
                component
                for component in container.components
                if self._components[component.name] == place[0]
            ),
            connectors=tuple(
                end
                for end in container.connectors
                if self._ends[end.name, end.end] == place
            ),
        )


def _with(now: ContainerStatus, before: ContainerStatus | None) -> ContainerStatus:
    """Return a container with what it had before and has no more."""
    if before is None:
        return now
    return replace(
        now,
        components=(*now.components, *_gone(now.components, before.components)),
        connectors=(*now.connectors, *_gone(now.connectors, before.connectors)),
    )


S = TypeVar("S", ComponentStatus, ConnectorStatus)


def _gone(now: tuple[S, ...], before: tuple[S, ...]) -> list[S]:
    here = {_key(each) for each in now}
    return [each for each in before if _key(each) not in here]


def _key(each: ComponentStatus | ConnectorStatus) -> tuple[str, str]:
    return each.name, each.end if isinstance(each, ConnectorStatus) else ""
