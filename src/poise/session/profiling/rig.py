"""The robot with which one architecture is measured, on a computer for itself.

Its sources and providers, and theirs, run on another one, at most one architecture of
each function. A replay component plays what is recorded or generated instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from poise.errors import UsageError
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
    Simulator,
)
from poise.runtime.replay import PlayedPort
from poise.session.bag_workload import PlayedBag, played_bag, topic_name
from poise.session.record_run import coded_ports, interface_type, message_type
from poise.wire.bag_file import is_bag
from poise.wire.recording_file import check_recorded, inputs_of

PLAYER = "player-of-workload"
REPLAY = "poise.runtime.replay:Replay"
BAG_PLAYER = "poise.ros2.bag_player:BagPlayer"


class Played(Struct, frozen=True):
    """The inputs that come from a replay component instead of their sources."""

    # Input as component.port -> its messages or calls
    parts: Mapping[str, PlayedPort] = {}
    recording: str = ""  # The recording's file; empty: none
    bag: PlayedBag | None = None
    running: AbstractSet[str] = frozenset()  # Components that make their calls

    def beside(self, running: AbstractSet[str]) -> Played:
        """Return what is played beside components, which need their calls' answers."""
        parts = {}
        for input_, part in self.parts.items():
            sources = tuple(
                source
                for source in part.sources
                if not (part.calls and source.rpartition(".")[0] in running)
            )
            if sources or part.generated:
                parts[input_] = replace(part, sources=sources)
        return replace(self, parts=parts, running=running)

    def covers(self, connector: Connector) -> bool:
        """Return whether what a connector brings is played."""
        topics = self.bag.topics if self.bag else ()
        return topic_name(connector.topic) in topics or self.replaces(connector)

    def replaces(self, connector: Connector) -> bool:
        """Return whether the replay component replaces a connector."""
        source, target = connector.between
        part = self.parts.get(str(target))
        return part is not None and not (
            part.calls and source.component in self.running
        )

    def is_empty(self) -> bool:
        """Return whether nothing is played."""
        return not self.parts and self.bag is None

    def player(self) -> Architecture:
        """Return the replay component, with its own container."""
        parameters = {
            "recording": self.recording,
            "ports": {
                made.between[0].port: msgspec.to_builtins(self.parts[input_])
                for input_, made in self._made().items()
            },
            **(msgspec.to_builtins(self.bag) if self.bag else {}),
        }
        component = ComponentEntry(
            name=PLAYER,
            implementation=BAG_PLAYER if self.bag else REPLAY,
            isolated=True,
            parameters=parameters,
        )
        return Architecture(name=PLAYER, function=PLAYER, components=(component,))

    def _made(self) -> dict[str, Connector]:
        """Return input -> the replay component's connector to it."""
        made = {}
        for number, input_ in enumerate(self.parts):
            component, _, port = input_.partition(".")
            source = ConnectorEnd(PLAYER, f"output_{number}")
            made[input_] = Connector(between=(source, ConnectorEnd(component, port)))
        return made

    def connectors(self, robot: Robot) -> tuple[Connector, ...]:
        """Return the robot's connectors with the replaced ones."""
        kept = tuple(c for c in robot.connectors if not self.replaces(c))
        return (*kept, *self._made().values())

    def names(self, robot: Robot) -> dict[str, str]:
        """Return replaced connectors of the robot -> their replacements."""
        made = self._made()
        replaced = (c for c in robot.connectors if self.replaces(c))
        return {str(c): str(made[str(c.between[1])]) for c in replaced}


def played(robot: Robot) -> Played:
    """Return the inputs that the robot's workload replays."""
    workload = robot.workload
    if workload is None:
        return Played()
    parts: dict[str, PlayedPort] = {}
    recording, bag = "", None
    if workload.recording:
        path = (Path(robot.folder) / workload.recording).absolute()
        if is_bag(path):
            bag = played_bag(robot, path)
        else:
            recording = str(path)
            parts |= _recorded(robot, recording)
    for each in workload.generate:  # generated ones replace recorded ones
        type_ = message_type(robot, each.port)
        parts[str(each.port)] = PlayedPort(type=type_, generated=each)
    return Played(parts, recording, bag)


def _recorded(robot: Robot, recording: str) -> dict[str, PlayedPort]:
    try:
        check_recorded(Path(recording), robot.name)
        inputs = inputs_of(Path(recording))
    except UsageError as error:
        raise UsageError(
            f"workload: {error}. `poise run --record` writes a recording"
        ) from error
    found = _parts(robot, {each.source for each in inputs})
    if not found:
        raise UsageError(
            f"workload: recording {recording} has no messages from one "
            f"architecture of '{robot.name}' to another: `poise run --record` records "
            "these, and `poise up --record` does not"
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


OTHERS = "others"
_ROUNDING = 1e-9
EMPTY = "empty-container"
"""A component that does nothing; its container shows the cost of a container."""


class ProfilingRig(Struct, frozen=True):
    """A robot with which one architecture is measured."""

    robot: Robot
    computer: str  # The computer of the architecture
    placement: Mapping[str, str]
    measured: tuple[str, ...]  # Names of its components
    promised: float  # Cores that the computer must have had
    # Connectors of the robot -> connectors of the replay in their place
    played: Mapping[str, str] = {}


def rig_of(
    robot: Robot, architecture: str, computer: str, *, apart: bool
) -> ProfilingRig:
    """Return the rig for an architecture of `robot`."""
    chosen = robot.architecture(architecture)
    if computer not in {c.name for c in robot.hosts}:
        known = ", ".join(c.name for c in robot.hosts)
        raise UsageError(f"--on {computer}: the robot's computers are {known}")
    playing = played(robot)
    feeding = _feeding(robot, chosen, playing)
    if apart:
        chosen = _apart(chosen)
    here = {c.name: computer for c in chosen.components}
    fed = {c.name for architecture in feeding for c in architecture.components}
    playing = playing.beside({*here, *fed})
    made = _emulated if robot.is_emulated else _real
    rig, elsewhere = made(robot, computer)
    others = feeding if playing.is_empty() else (*feeding, playing.player())
    beside = {c.name: elsewhere for a in others for c in a.components}
    there = {*here, *beside}
    placement = _held_by_devices(rig, {**here, **beside}, (chosen, *others))
    connectors = tuple(
        connector
        for connector in playing.connectors(robot)
        if there.issuperset(end.component for end in connector.between)
    )
    return ProfilingRig(
        replace(rig, architectures=(chosen, *others), connectors=connectors),
        computer,
        placement,
        tuple(name for name in here if name != EMPTY),
        robot.computer(computer).total("cpu"),
        playing.names(robot),
    )


def _emulated(robot: Robot, computer: str) -> tuple[Robot, str]:
    """Return the robot with one other computer, as large as all together.

    The chosen one has whole cores: CPU time is the same there, and a full computer
    would keep timers and calls from their rates.
    """
    chosen = robot.computer(computer)
    cores = math.ceil(chosen.total("cpu") - _ROUNDING) / chosen.speed
    chosen = replace(chosen, capacity={**chosen.capacity, "cpu": cores})
    total = sum(c.total("cpu") for c in robot.hosts)
    memory = sum(c.capacity["memory"] for c in robot.hosts)
    others = Computer(name=OTHERS, capacity={"cpu": total, "memory": memory})
    rig = replace(
        robot,
        computers=(chosen, others),
        links=(),
        # one machine emulates both, so its simulator reaches both
        devices=tuple(replace(each, computer=computer) for each in robot.devices),
        simulator=_simulator(robot),
    )
    return rig, OTHERS


def _real(robot: Robot, computer: str) -> tuple[Robot, str]:
    names = [c.name for c in robot.hosts if c.name != computer]
    rig = replace(robot, simulator=_simulator(robot))
    return rig, names[0] if names else computer


def _simulator(robot: Robot) -> Simulator | None:
    if robot.workload is not None and robot.workload.command:
        return Simulator(command=robot.workload.command)
    return robot.simulator


def _held_by_devices(
    rig: Robot, placement: Mapping[str, str], architectures: tuple[Architecture, ...]
) -> dict[str, str]:
    """Return the placement, with components of real devices at their devices."""
    if rig.is_emulated:
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
    alone = (replace(each, isolated=True) for each in architecture.components)
    return replace(architecture, components=(*alone, empty))


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
        if owner[target.component].name == name:
            if not playing.covers(connector):
                yield owner[source.component]
        elif owner[source.component].name == name and source.port in _required(
            robot, source.component
        ):
            yield owner[target.component]  # played calls answer nobody


def _required(robot: Robot, name: str) -> set[str]:
    """Return the names of a component's required ports."""
    component = robot.component(name)
    coded = coded_ports(robot, component)
    kinds = {name: port.kind for name, port in coded.items()}
    kinds = kinds or {port.name: port.kind for port in component.ports}
    return {name for name, kind in kinds.items() if kind == "requires"}
