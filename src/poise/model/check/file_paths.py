"""The parts of a robot, each with its path in the robot file."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.robot import Architecture, ComponentEntry, Connector, Robot
from poise.model.yaml.positions import Path


def components(robot: Robot) -> Iterator[tuple[Path, Architecture, ComponentEntry]]:
    """Yield every component with its path and its architecture."""
    for architecture in robot.architectures:
        for component in architecture.components:
            path = ("architectures", architecture.name, "components", component.name)
            yield path, architecture, component


def connectors(robot: Robot) -> Iterator[tuple[Path, Architecture | None, Connector]]:
    """Yield every connector with its path and its architecture, if it is in one."""
    for architecture in robot.architectures:
        for index, connector in enumerate(architecture.connectors):
            path = ("architectures", architecture.name, "connectors", index)
            yield path, architecture, connector
    for index, connector in enumerate(robot.connectors):
        yield ("connectors", index), None, connector


def component_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of all components."""
    return tuple(component.name for component in robot.components())
