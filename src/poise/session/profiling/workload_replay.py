"""Replaces the sources of a rig by one component that replays a workload."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import UsageError
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.runtime.workload.replay import PlayedPort
from poise.session.recordings.tapped_robot import interface_type, message_type
from poise.wire.recording_file import load

PLAYER = "player-of-workload"


class Played(Struct, frozen=True):
    """The inputs that come from a replay component instead of their sources.

    Parameters
    ----------
    parts
        Input as component.port -> its messages or calls.
    recording
        The recording's file; empty: none.
    """

    parts: Mapping[str, PlayedPort] = {}
    recording: str = ""

    def covers(self, connector: Connector) -> bool:
        """Return whether the replay component replaces a connector."""
        return str(connector.between[1]) in self.parts

    def player(self) -> Architecture:
        """Return the replay component, with its own container."""
        parameters = {
            "recording": self.recording,
            "ports": {
                name: msgspec.to_builtins(self.parts[input_])
                for input_, name in self.ports().items()
            },
        }
        component = ComponentEntry(
            name=PLAYER,
            implementation="poise.runtime.workload.replay:Replay",
            isolated=True,
            parameters=parameters,
        )
        return Architecture(name=PLAYER, function=PLAYER, components=(component,))

    def ports(self) -> dict[str, str]:
        """Return input -> the replay component's port for it."""
        return {input_: f"output_{i}" for i, input_ in enumerate(self.parts)}

    def connectors(self, robot: Robot) -> tuple[Connector, ...]:
        """Return the robot's connectors with the replaced ones."""
        kept = tuple(c for c in robot.connectors if not self.covers(c))
        return (*kept, *(self._connector(*each) for each in self.ports().items()))

    def names(self, robot: Robot) -> dict[str, str]:
        """Return replaced connectors of the robot -> their replacements."""
        ports = self.ports()
        return {
            str(c): str(self._connector(str(c.between[1]), ports[str(c.between[1])]))
            for c in robot.connectors
            if self.covers(c)
        }

    @staticmethod
    def _connector(input_: str, name: str) -> Connector:
        component, _, port = input_.partition(".")
        return Connector(
            between=(ConnectorEnd(PLAYER, name), ConnectorEnd(component, port))
        )


def played(robot: Robot) -> Played:
    """Return the inputs that the robot's workload replays.

    Raises
    ------
    UsageError
        The recording cannot be read, or has no input of this robot.
    """
    workload = robot.workload
    if workload is None:
        return Played()
    parts: dict[str, PlayedPort] = {}
    recording = ""
    if workload.recording:
        recording = str((Path(robot.folder) / workload.recording).absolute())
        parts |= _recorded(robot, recording)
    for each in workload.generate:  # generated ones replace recorded ones
        type_ = message_type(robot, each.port)
        parts[str(each.port)] = PlayedPort(type=type_, generated=each)
    return Played(parts, recording)


def _recorded(robot: Robot, recording: str) -> dict[str, PlayedPort]:
    try:
        inputs = load(Path(recording)).inputs
    except UsageError as error:
        raise UsageError(
            f"workload: recording {recording} cannot be replayed: {error}. "
            "`poise run --record` writes one"
        ) from error
    found = _parts(robot, {each.source for each in inputs})
    if not found:
        raise UsageError(
            f"workload: recording {recording} has no messages from one "
            f"architecture of '{robot.name}' to another"
        )
    return found


def _parts(robot: Robot, known: AbstractSet[str]) -> dict[str, PlayedPort]:
    """Return input -> its recorded sources."""
    parts: dict[str, PlayedPort] = {}
    for connector in robot.connectors:
        source, target = connector.between
        if str(source) in known:
            interface = interface_type(robot, source)
            before = parts.get(str(target), PlayedPort(type=""))
            parts[str(target)] = PlayedPort(
                type=interface or message_type(robot, source),
                calls=bool(interface),
                sources=(*before.sources, str(source)),
            )
    return parts
