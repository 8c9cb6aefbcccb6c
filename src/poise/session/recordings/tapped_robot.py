"""A robot that writes down what goes between architectures: messages and calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.model.robot import Architecture, Component, Connector, End, Robot
from poise.runtime.component.implementation import find
from poise.runtime.component.ports import ports_of

RECORDER = "recorder-of-inputs"


class Tapped(Struct, frozen=True):
    """The robot, where its components run, and which component.port is written down.

    `sources` publish, `callers` call.
    """

    robot: Robot
    placement: Mapping[str, str]
    sources: tuple[str, ...]
    callers: tuple[str, ...] = ()


def tapped(robot: Robot, placement: Mapping[str, str], path: Path) -> Tapped:
    """Return the robot with a recorder of what goes between architectures.

    For messages there is one component more, with a container of its own on the
    robot's first computer; calls are noted where they come. All is written to `path`
    on the computer where that is.
    """
    robot, callers = _noting_calls(robot, placement, path)
    sources = dict(published_between(robot, placement))
    if not sources:
        return Tapped(robot, placement, (), callers)
    names = {f"input_{i}": source for i, source in enumerate(sources)}
    ports = {name: (source, sources[source]) for name, source in names.items()}
    recorder = Component(
        name=RECORDER,
        implementation="poise.runtime.workload.recorder:Recorder",
        isolated=True,
        parameters={"path": str(path.absolute()), "ports": ports},
    )
    connectors = tuple(
        Connector(between=(_end(source), End(RECORDER, name)))
        for name, source in names.items()
    )
    architecture = Architecture(
        name=RECORDER, function=RECORDER, components=(recorder,)
    )
    return Tapped(
        msgspec.structs.replace(
            robot,
            architectures=(*robot.architectures, architecture),
            connectors=(*robot.connectors, *connectors),
        ),
        {**placement, RECORDER: robot.computers[0].name},
        tuple(sources),
        callers,
    )


def _noting_calls(
    robot: Robot, placed: Mapping[str, str], path: Path
) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with calls between architectures noted; and who calls."""
    record = str(path.absolute())
    called = {
        connector: msgspec.structs.replace(connector, record=record)
        for connector in robot.connectors
        if all(end.component in placed for end in connector.between)
        and interface_type(robot, connector.between[1])
    }
    connectors = tuple(called.get(each, each) for each in robot.connectors)
    callers = tuple(str(each.between[0]) for each in called)
    return msgspec.structs.replace(robot, connectors=connectors), callers


def published_between(
    robot: Robot, placed: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield what is published to other architectures: component.port and its type."""
    for connector in robot.connectors:
        source, target = connector.between
        if source.component in placed and target.component in placed:
            type_ = message_type(robot, source)
            if type_:
                yield str(source), type_


def message_type(robot: Robot, end: End) -> str:
    """Return the type of a topic's port as package.module:Class; empty: it is none."""
    return _type(robot, end, ("publishes", "subscribes"))


def interface_type(robot: Robot, end: End) -> str:
    """Return the interface of a port as package.module:Class; empty: it has none."""
    return _type(robot, end, ("requires", "provides"))


def _type(robot: Robot, end: End, kinds: tuple[str, ...]) -> str:
    component = next(c for c in robot.components() if c.name == end.component)
    if not component.implementation:
        return ""
    port = ports_of(find(component.implementation, robot.folder)).get(end.port)
    if port is None or port.kind not in kinds:
        return ""
    return f"{port.type.__module__}:{port.type.__qualname__}"


def _end(text: str) -> End:
    component, _, port = text.partition(".")
    return End(component, port)
