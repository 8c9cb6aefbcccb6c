"""What a run's statuses said last of all that ran, also of what is gone since."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from msgspec.structs import replace

from poise.manage.agent_connections.statuses import Statuses
from poise.wire.records.status import (
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Side,
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
        self.ended: list[ConnectorStatus] = []
        self._components: dict[str, tuple[Place, ComponentStatus]] = {}
        self._ends: dict[tuple[str, Side], tuple[Place, list[ConnectorStatus]]] = {}

    def look(self, statuses: Statuses) -> None:
        """Take what the agents say now; call it a few times a second."""
        for computer, status in sorted(statuses.items()):
            for container in status.containers:
                place = computer, container.name
                before = self._containers.get(place, container)
                if before.pid != container.pid:
                    self.ended += self._ends_at(place)
                self._containers[place] = container
                for each in container.components:
                    self._components[each.name] = place, each
                ends = sorted(container.connectors, key=_key)
                for key, same in groupby(ends, _key):  # of a source with two paths
                    self._ends[key] = place, list(same)

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
        components = (each for at, each in self._components.values() if at == place)
        ends = tuple(self._ends_at(place))
        return replace(container, components=tuple(components), connectors=ends)

    def _ends_at(self, place: Place) -> Iterator[ConnectorStatus]:
        for at, same in self._ends.values():
            if at == place:
                yield from same


def _key(end: ConnectorStatus) -> tuple[str, Side]:
    return end.name, end.end
