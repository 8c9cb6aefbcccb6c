"""The robot with which one architecture is measured alone.

Its components have a computer for themselves. Their sources and providers run on
another computer, together with the sources and providers of those. At most one
architecture of each function runs, as on the robot. A replay component takes the place
of sources whose messages are recorded or generated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import msgspec
from msgspec import Struct

from poise.errors import UsageError
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Device,
    Robot,
    Simulator,
)
from poise.runtime.component.implementation import find, search_also
from poise.runtime.component.ports import ports_of
from poise.session.profiling.workload_replay import Played, played

OTHERS = "others"
EMPTY = "empty-container"
"""A component that does nothing; its container shows the cost of a container."""


class ProfilingRig(Struct, frozen=True):
    """A robot with which one architecture is measured.

    Parameters
    ----------
    computer
        The computer of the architecture.
    measured
        Names of its components.
    played
        Connectors of the robot -> connectors of the replay in their place.
    """

    robot: Robot
    computer: str
    placement: Mapping[str, str]
    measured: tuple[str, ...]
    played: Mapping[str, str] = {}


def rig_of(
    robot: Robot, architecture: str, computer: str, *, apart: bool
) -> ProfilingRig:
    """Return the rig for an architecture of `robot`.

    Parameters
    ----------
    computer
        The computer of the robot to measure on.
    apart
        Whether every component gets its own container; an empty container then runs
        beside them.

    Raises
    ------
    UsageError
        There is no such computer.
    """
    chosen = robot.architecture(architecture)
    if computer not in {c.name for c in robot.computers}:
        known = ", ".join(c.name for c in robot.computers)
        raise UsageError(f"--on {computer}: the robot's computers are {known}")
    playing = played(robot)
    feeding = _feeding(robot, chosen, playing)
    if apart:
        chosen = _apart(chosen)
    here = {c.name: computer for c in chosen.components}
    made = _emulated if _is_emulated(robot) else _real
    rig, elsewhere = made(robot, computer)
    others = feeding if not playing.parts else (*feeding, playing.player())
    beside = {c.name: elsewhere for a in others for c in a.components}
    there = {*here, *beside}
    placement = _held_by_devices(rig, {**here, **beside}, (chosen, *others))
    return ProfilingRig(
        msgspec.structs.replace(
            rig,
            architectures=(chosen, *others),
            connectors=tuple(
                connector
                for connector in playing.connectors(robot)
                if there.issuperset(end.component for end in connector.between)
            ),
        ),
        computer,
        placement,
        tuple(name for name in here if name != EMPTY),
        playing.names(robot),
    )


def _is_emulated(robot: Robot) -> bool:
    return all(computer.address is None for computer in robot.computers)


def _emulated(robot: Robot, computer: str) -> tuple[Robot, str]:
    """Return the robot with one other computer, as large as all together."""
    chosen = robot.computer(computer)
    total = sum(c.total("cpu") for c in robot.computers)
    memory = sum(c.capacity["memory"] for c in robot.computers)
    others = Computer(name=OTHERS, capacity={"cpu": total, "memory": memory})
    rig = msgspec.structs.replace(
        robot,
        computers=(chosen, others),
        links=(),
        # one machine emulates both, so its simulator reaches both
        devices=tuple(_at(device, computer) for device in robot.devices),
        simulator=_simulator(robot),
    )
    return rig, OTHERS


def _real(robot: Robot, computer: str) -> tuple[Robot, str]:
    names = [c.name for c in robot.computers if c.name != computer]
    rig = msgspec.structs.replace(robot, simulator=_simulator(robot))
    return rig, names[0] if names else computer


def _simulator(robot: Robot) -> Simulator | None:
    if robot.workload is not None and robot.workload.command:
        return Simulator(command=robot.workload.command)
    return robot.simulator


def _at(device: Device, computer: str) -> Device:
    return msgspec.structs.replace(device, computer=computer)


def _held_by_devices(
    rig: Robot,
    placement: Mapping[str, str],
    architectures: tuple[Architecture, ...],
) -> dict[str, str]:
    """Return the placement, with components of real devices at their devices."""
    if _is_emulated(rig):
        return dict(placement)
    held = {
        component.name: rig.device(device).computer
        for architecture in architectures
        for component in architecture.components
        for device in component.devices
    }
    return {**placement, **held}


def _apart(architecture: Architecture) -> Architecture:
    empty = ComponentEntry(
        name=EMPTY,
        implementation="poise.runtime.component.component:Component",
        isolated=True,
    )
    alone = (
        msgspec.structs.replace(component, isolated=True)
        for component in architecture.components
    )
    return msgspec.structs.replace(architecture, components=(*alone, empty))


def _feeding(
    robot: Robot, chosen: Architecture, playing: Played
) -> tuple[Architecture, ...]:
    """Return the sources and providers of `chosen`, and theirs.

    Of alternatives that provide the same function only the best one is returned: no
    message reaches either when both run.
    """
    owner = {c.name: a for a in robot.architectures for c in a.components}
    running = {chosen.function: chosen.name}
    names = [chosen.name]
    for name in names:  # grows meanwhile
        needed = _needed(robot, name, owner, playing)
        for other in sorted(needed, key=lambda each: -each.quality):
            if other.function not in running:
                running[other.function] = other.name
                names.append(other.name)
    return tuple(a for a in robot.architectures if a.name in names[1:])


def _needed(
    robot: Robot, name: str, owner: Mapping[str, Architecture], playing: Played
) -> Iterator[Architecture]:
    """Yield the architectures whose messages, calls or answers `name` needs."""
    for connector in robot.connectors:
        source, target = connector.between
        if playing.covers(connector):
            continue
        if owner[target.component].name == name:
            yield owner[source.component]
        elif owner[source.component].name == name and source.port in _required(
            robot, source.component
        ):
            yield owner[target.component]


def _required(robot: Robot, name: str) -> set[str]:
    """Return the names of a component's required ports."""
    component = robot.component(name)
    if not component.implementation:
        return {port.name for port in component.ports if port.kind == "requires"}
    search_also(robot.repository)
    ports = ports_of(find(component.implementation, robot.folder)).values()
    return {port.name for port in ports if port.kind == "requires"}
