"""A robot that records what goes between architectures: messages and calls."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.model.robot import ConnectorEnd, Robot
from poise.runtime.component.implementation import find, search_also
from poise.runtime.component.ports import ports_of


class Tapped(Struct, frozen=True):
    """The robot, and which component.port is recorded.

    `sources` publish, `callers` call.
    """

    robot: Robot
    sources: tuple[str, ...] = ()
    callers: tuple[str, ...] = ()


def tapped(robot: Robot, placed: Collection[str], path: Path) -> Tapped:
    """Return the robot with what goes between placed architectures recorded.

    It is written where it comes, a message to several at the first of them, to `path`
    on the computer where that is.
    """
    connectors, sources, callers = [], [], []
    for connector in robot.connectors:
        source, target = connector.between
        is_recorded = False
        if source.component in placed and target.component in placed:
            if interface_type(robot, target):
                callers.append(str(source))
                is_recorded = True
            elif message_type(robot, source) and str(source) not in sources:
                sources.append(str(source))
                is_recorded = True
        record = str(path.absolute()) if is_recorded else ""
        connectors.append(msgspec.structs.replace(connector, record=record))
    noted = msgspec.structs.replace(robot, connectors=tuple(connectors))
    return Tapped(noted, tuple(sources), tuple(callers))


def message_type(robot: Robot, end: ConnectorEnd) -> str:
    """Return the type of a topic's port as package.module:Class; empty: it is none."""
    return _type(robot, end, ("publishes", "subscribes"))


def interface_type(robot: Robot, end: ConnectorEnd) -> str:
    """Return the interface of a port as package.module:Class; empty: it has none."""
    return _type(robot, end, ("requires", "provides"))


def _type(robot: Robot, end: ConnectorEnd, kinds: tuple[str, ...]) -> str:
    component = next(c for c in robot.components() if c.name == end.component)
    if not component.implementation:
        return ""
    search_also(robot.repository)
    port = ports_of(find(component.implementation, robot.folder)).get(end.port)
    if port is None or port.kind not in kinds:
        return ""
    return f"{port.type.__module__}:{port.type.__qualname__}"
