"""Replaces the sources of a rig by one component that replays a workload."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import UsageError
from poise.model.robot import Architecture, Component, Connector, End, Robot
from poise.runtime.workload.replay import Part, read_recorded
from poise.session.recordings.tapped_robot import interface_type, message_type

PLAYER = "player-of-workload"


class Played(Struct, frozen=True):
    """What comes from the player instead of from others.

    Parameters
    ----------
    parts
        Input, as component.port -> what comes there.
    recording
        The file that is played; empty: there is none.
    """

    parts: Mapping[str, Part] = {}
    recording: str = ""

    def covers(self, connector: Connector) -> bool:
        """Return whether the player takes a connector's place."""
        return str(connector.between[1]) in self.parts

    def player(self) -> Architecture:
        """Return the player, with a container of its own."""
        parameters = {
            "recording": self.recording,
            "ports": {
                name: msgspec.to_builtins(self.parts[input_])
                for input_, name in self.ports().items()
            },
        }
        component = Component(
            name=PLAYER,
            implementation="poise.runtime.workload.replay:Replay",
            isolated=True,
            parameters=parameters,
        )
        return Architecture(name=PLAYER, function=PLAYER, components=(component,))

    def ports(self) -> dict[str, str]:
        """Return input -> the player's port for it."""
        return {input_: f"output_{i}" for i, input_ in enumerate(self.parts)}

    def connectors(self, robot: Robot) -> tuple[Connector, ...]:
        """Return the robot's connectors with the player in its place."""
        kept = tuple(c for c in robot.connectors if not self.covers(c))
        return (*kept, *(self._connector(*each) for each in self.ports().items()))

    def names(self, robot: Robot) -> dict[str, str]:
        """Return the robot's connectors -> those that take their places."""
        ports = self.ports()
        return {
            str(c): str(self._connector(str(c.between[1]), ports[str(c.between[1])]))
            for c in robot.connectors
            if self.covers(c)
        }

    @staticmethod
    def _connector(input_: str, name: str) -> Connector:
        component, _, port = input_.partition(".")
        return Connector(between=(End(PLAYER, name), End(component, port)))


def played(robot: Robot) -> Played:
    """Return what the robot's workload plays.

    Raises
    ------
    UsageError
        The recording cannot be read, or holds nothing that this robot takes.
    """
    workload = robot.workload
    if workload is None:
        return Played()
    parts: dict[str, Part] = {}
    recording = ""
    if workload.recording:
        recording = str((Path(robot.folder) / workload.recording).absolute())
        parts |= _recorded(robot, recording)
    for each in workload.generate:  # made up wins over recorded
        parts[str(each.port)] = Part(
            type=message_type(robot, each.port),
            rate=each.rate,
            arrivals=each.arrivals,
            size=each.size,
            variation=each.variation,
            message=each.message,
            seed=each.seed,
        )
    return Played(parts, recording)


def _recorded(robot: Robot, recording: str) -> dict[str, Part]:
    try:
        inputs = read_recorded(Path(recording))
    except (OSError, msgspec.DecodeError) as error:
        raise UsageError(
            f"workload: recording {recording} cannot be played: {error}. "
            "`poise run --record` writes one"
        ) from error
    found = _parts(robot, {each.source for each in inputs})
    if not found:
        raise UsageError(
            f"workload: recording {recording} holds nothing that goes from one "
            f"architecture of '{robot.name}' to another"
        )
    return found


def _parts(robot: Robot, known: AbstractSet[str]) -> dict[str, Part]:
    """Return input -> what comes there of all sources that were recorded."""
    parts: dict[str, Part] = {}
    for connector in robot.connectors:
        source, target = connector.between
        if str(source) in known:
            interface = interface_type(robot, source)
            before = parts.get(str(target), Part(type=""))
            parts[str(target)] = Part(
                type=interface or message_type(robot, source),
                calls=bool(interface),
                sources=(*before.sources, str(source)),
            )
    return parts
