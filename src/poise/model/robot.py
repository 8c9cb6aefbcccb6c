"""The records of a robot: pure, frozen, in SI units (cores, bytes, seconds, bytes/s).

`poise.model.loading` reads them from a robot file; `says` describes its keys.
Names are unique within their kind; names of components are unique in the whole robot.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from itertools import chain
from typing import Annotated, Literal, Protocol, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from poise.model.file_keys import (
    COMMAND,
    Amount,
    Bytes,
    FunctionReference,
    Name,
    PortKind,
    Rate,
    Seconds,
    Share,
    by_name,
    by_port,
    note,
    says,
)
from poise.model.hardware import Computer, Device, Link
from poise.model.includes import Include
from poise.model.policy import POLICIES, Policy
from poise.model.software import (
    Architecture,
    ComponentCode,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    DeclaredPort,
    Layer,
    Ros2Network,
    WhenCutOff,
)
from poise.model.steps import PREFETCH, Action, Prefetch, Task, actions_of

__all__ = [
    "Action",
    "Architecture",
    "Arrivals",
    "Chain",
    "ComponentEntry",
    "Computer",
    "Connector",
    "ConnectorEnd",
    "DeclaredPort",
    "Device",
    "Generated",
    "Layer",
    "Link",
    "Objective",
    "Policy",
    "PortKind",
    "Robot",
    "Simulator",
    "Task",
    "Workload",
]

Scale = Literal["normalised", "paper"]
Spread = Literal["range", "variance"]
Arrivals = Literal["regular", "poisson"]


class Chain(Struct, frozen=True, kw_only=True):
    """An end-to-end deadline over a chain of components."""

    name: str
    through: Annotated[
        tuple[Name, ...], says("The components, first to last.", min_length=2)
    ]
    deadline: Annotated[
        Seconds, says("The oldest that data may be at its last use.", gt=0)
    ]


class Objective(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The weights of a good placement.

    All are finite and >= 0 (docs/design/objective.md); `communication` and `balance`
    are the paper's omega_1 and omega_2. The greedy orders components by size. `quality`
    is what F grows by for every unit of quality lost by choosing an architecture that
    is not the best one for its function.
    """

    communication: Annotated[
        Amount, says("Weight of the communication between computers.")
    ] = 0.5
    balance: Annotated[
        Amount, says("Weight of how unevenly the free capacity is spread.")
    ] = 0.5
    scale: Annotated[
        Scale, says("Shares of capacity and of all overhead, or raw units.")
    ] = "normalised"
    spread: Annotated[
        Spread, says("Largest minus smallest residue, or its population variance.")
    ] = "range"
    weights: Annotated[
        Mapping[Name, Amount], says("Weight of each resource in the balance.")
    ] = {}
    sizes: Annotated[
        Mapping[Name, Amount], says("Weight of each resource in a component's size.")
    ] = {}
    quality: Annotated[
        Amount, says("Weight of the quality lost by a lesser alternative.")
    ] = 1.0


class Simulator(Struct, frozen=True, kw_only=True):
    """The simulated world of an emulated robot.

    It runs outside every emulated computer's limits, with the run's folder in the
    environment variable ``POISE_RUN``; devices' paths are relative to that folder. The
    last line it prints is a JSON object that goes into the run's report.
    """

    command: Annotated[tuple[str, ...], COMMAND, says("Its command line.")]


class Generated(Struct, frozen=True, kw_only=True):
    """Messages that are generated for a port while components are measured."""

    port: ConnectorEnd
    rate: Annotated[Rate, says("On average: 10 Hz.", gt=0)]
    arrivals: Annotated[
        Arrivals, says("At equal distances, or at random ones (Poisson).")
    ] = "regular"
    size: Annotated[
        Bytes, says("Mean size, encoded: 1.5 kB. Without it, as small as can be.")
    ] = 0.0
    variation: Annotated[
        Share, says("Sizes vary evenly within this share of the mean: 20%.", lt=1)
    ] = 0.0
    message: Annotated[
        FunctionReference,
        says(
            "package.module:function that makes a message of a random.Random and a "
            "size [bytes]; without it, its fields are filled at random.",
            is_nullable=True,
        ),
    ] = ""
    seed: Annotated[int, says("The same seed makes the same messages.")] = 0


class Workload(Struct, frozen=True, kw_only=True):
    """What components work on while `poise profile` measures them."""

    command: Annotated[
        tuple[str, ...],
        COMMAND,
        says("A command line that runs instead of the simulator.", is_nullable=True),
    ] = ()
    recording: Annotated[
        str,
        says(
            "A file of `poise run --record`, relative to this one: what other "
            "architectures published then comes from there. Or a bag of ROS 2: what "
            "bridges and nodes take comes from there.",
            is_nullable=True,
        ),
    ] = ""
    generate: Annotated[
        tuple[Generated, ...],
        by_port(Generated),
        says("Subscribed component.port -> messages that are generated for it."),
    ] = ()


Set = Annotated[tuple[Name, ...], note(min_length=2)]


LEAST_VOTES = 3
"""Of fewer computers that have a vote each, no majority is left when one is lost."""


class Robot(Struct, frozen=True, kw_only=True):
    """A robot: its computers, its software and its tasks.

    Implementations are imported from `folder`, that of the file. `code` is what the
    classes of components declare; those are not named whose code was not read.
    """

    name: Annotated[Name, says("The robot's name.", key="robot")]
    include: Annotated[
        tuple[str | Include, ...],
        says("Further files, relative to this one; sections are merged."),
    ] = ()
    poise: Annotated[
        str, says("The oldest version of Poise that understands it, as in `0.2`.")
    ] = ""
    arguments: Annotated[
        Mapping[Name, str],
        says("Name -> default of what $(name) stands for; `--set name=value` sets it."),
    ] = {}
    computers: Annotated[
        tuple[Computer, ...],
        by_name(Computer),
        says("The computers by name.", is_required=True, min_length=1),
    ] = ()
    devices: Annotated[
        tuple[Device, ...], by_name(Device), says("Sensors and actuators.")
    ] = ()
    links: Annotated[tuple[Link, ...], says("Network links between computers.")] = ()
    architectures: Annotated[
        tuple[Architecture, ...],
        by_name(Architecture),
        says("The software, one entry per function."),
    ] = ()
    connectors: Annotated[
        tuple[Connector, ...], says("Connectors between architectures.")
    ] = ()
    repository: Annotated[
        tuple[str, ...],
        says(
            "Folders of architecture files, relative to this one: they provide "
            "functions that tasks name."
        ),
    ] = ()
    explore: Annotated[
        bool,
        says(
            "Whether alternatives are tried at random, in proportion to what they "
            "promise, so that more is learned of them."
        ),
    ] = False
    insecure: Annotated[
        bool,
        says(
            "Whether computers with an `address` go without keys: whoever reaches one "
            "can then run code there."
        ),
    ] = False
    chains: Annotated[
        tuple[Chain, ...], by_name(Chain), says("End-to-end deadlines.")
    ] = ()
    tasks: Annotated[
        tuple[Task, ...], by_name(Task), says("The tasks of the robot.")
    ] = ()
    prefetch: Annotated[
        Prefetch,
        PREFETCH,
        says("How much is prepared for the next actions while others run, or `off`."),
    ] = Prefetch()
    objective: Annotated[Objective, says("The weights of a good placement.")] = (
        Objective()
    )
    together: Annotated[
        tuple[Set, ...], says("Sets of components that share a computer.")
    ] = ()
    apart: Annotated[
        tuple[Set, ...], says("Sets of components that are on different computers.")
    ] = ()
    policies: Annotated[
        tuple[Policy, ...],
        POLICIES,
        says("What is done when; `off` switches a shipped policy off."),
    ] = ()
    when_cut_off: Annotated[
        WhenCutOff,
        says(
            "What movable components do while their computer is cut off: stop, since "
            "they may run elsewhere by then, or go on."
        ),
    ] = "stop"
    manager: Annotated[
        tuple[Name, ...] | None,
        says(
            "Computers where a standby waits to lead the robot when its manager is "
            "gone, the first one first; without it, all of three real ones or more; [] "
            "none: a person starts the next manager."
        ),
    ] = None
    keeps: Annotated[
        tuple[Name, ...],
        says(
            "Devices whose computer goes on with a manager when half of the computers "
            "are out of reach."
        ),
    ] = ()
    simulator: Annotated[
        Simulator | None, says("The simulated world of an emulated robot.")
    ] = None
    workload: Annotated[
        Workload | None,
        says("What components work on while `poise profile` measures them."),
    ] = None
    profile: Annotated[
        str,
        says(
            "The file, relative to this one, that `poise profile` writes; demands, "
            "states and traffic that are not given here come from it.",
            is_nullable=True,
        ),
    ] = ""
    ros2: Annotated[Ros2Network, says("ROS 2 around it: discovery, and bridges.")] = (
        Ros2Network()
    )
    folder: str = ""
    deployed: str = ""
    """The version of its code that its computers run; empty: what is in `folder`."""
    code: Mapping[str, ComponentCode] = {}
    success: Mapping[str, float] = {}
    """Action -> how often it succeeds, in (0, 1), where that was learned."""

    def components(self) -> Iterator[ComponentEntry]:
        """Return every component of every architecture."""
        return chain.from_iterable([a.components for a in self.architectures])

    def with_components(
        self, change: Callable[[ComponentEntry], ComponentEntry | None]
    ) -> Robot:
        """Return the robot with every component as `change` returns it; None: without.

        An architecture that keeps no component is left out, too.
        """
        architectures = []
        for architecture in self.architectures:
            changed = tuple(filter(None, map(change, architecture.components)))
            if changed:
                architectures.append(replace(architecture, components=changed))
        return replace(self, architectures=tuple(architectures))

    def with_connectors(self, change: Callable[[Connector], Connector]) -> Robot:
        """Return the robot with every connector as `change` returns it."""
        architectures = (
            replace(a, connectors=tuple(map(change, a.connectors)))
            for a in self.architectures
        )
        return replace(
            self,
            architectures=tuple(architectures),
            connectors=tuple(map(change, self.connectors)),
        )

    def demands(self, resource: str) -> dict[str, float]:
        """Return component -> its demand of a resource; 0 where it has none."""
        return {c.name: c.demand.get(resource, 0.0) for c in self.components()}

    def on(self, computers: Iterable[Computer]) -> Robot:
        """Return the robot with other computers, and the links between them."""
        computers = tuple(computers)
        names = {computer.name for computer in computers}
        links = tuple(link for link in self.links if names.issuperset(link.between))
        return replace(self, computers=computers, links=links)

    @property
    def hosts(self) -> tuple[Computer, ...]:
        """The computers on which components may be placed."""
        return tuple(c for c in self.computers if not c.witness)

    @property
    def standbys(self) -> tuple[str, ...]:
        """The computers where a standby waits, the first one to lead first."""
        if self.manager is not None:
            return self.manager
        is_enough = len(self.computers) >= LEAST_VOTES or self.keeps
        may_lead = is_enough and not self.is_emulated
        return tuple(c.name for c in self.hosts) if may_lead else ()

    @property
    def votes(self) -> dict[str, int]:
        """Computer -> how many votes it has for the next manager."""
        keeper = {d.computer for d in self.devices if d.name in self.keeps}
        return {c.name: 1 + (c.name in keeper) for c in self.computers}

    @property
    def folders(self) -> tuple[str, ...]:
        """Where its implementations are imported from."""
        return (self.folder, *self.repository)

    @property
    def is_emulated(self) -> bool:
        """Whether its computers have no addresses: one machine emulates them."""
        return all(computer.address is None for computer in self.computers)

    def all_connectors(self) -> Iterator[Connector]:
        """Return every connector, inside architectures first, then between them."""
        return chain(*[a.connectors for a in self.architectures], self.connectors)

    def architecture(self, name: str) -> Architecture:
        """Return the architecture called `name`; KeyError when there is none."""
        return _named(self.architectures, name)

    def architecture_of(self, component: str) -> Architecture:
        """Return the architecture that has a component; KeyError when there is none."""
        for architecture in self.architectures:
            if any(c.name == component for c in architecture.components):
                return architecture
        raise KeyError(component)

    def component(self, name: str) -> ComponentEntry:
        """Return the component called `name`; KeyError when there is none."""
        return _named(tuple(self.components()), name)

    def task(self, name: str) -> Task:
        """Return the task called `name`; KeyError when there is none."""
        return _named(self.tasks, name)

    def actions(self, task: str | None = None) -> Iterator[Action]:
        """Yield the actions of a task, and of the tasks that it names; None: of all."""
        tasks = {task.name: task for task in self.tasks}
        for name in tasks if task is None else (task,):
            yield from actions_of(tasks, name)

    def functions_of(self, task: str | None = None) -> tuple[str, ...]:
        """Return all functions that a task needs, each once, in order; None: all tasks.

        Those of the tasks that it names are among them, and those of actions that are
        done on failure. There are none when there is no such task.
        """
        return tuple(dict.fromkeys(f for a in self.actions(task) for f in a.functions))

    def whole(self, components: Container[str]) -> list[Architecture]:
        """Return the architectures all of whose components are among `components`."""
        return [
            architecture
            for architecture in self.architectures
            if all(c.name in components for c in architecture.components)
        ]

    def components_for(self, functions: Collection[str]) -> set[str]:
        """Return the names of all components that help to provide functions."""
        return {
            component.name
            for architecture in self.architectures
            if architecture.function in functions
            for component in architecture.components
        }

    def computer(self, name: str) -> Computer:
        """Return the computer called `name`; KeyError when there is none."""
        return _named(self.computers, name)

    def device(self, name: str) -> Device:
        """Return the device called `name`; KeyError when there is none."""
        return _named(self.devices, name)


class _Named(Protocol):
    @property
    def name(self) -> str: ...


N = TypeVar("N", bound=_Named)


def _named(things: tuple[N, ...], name: str) -> N:
    for thing in things:
        if thing.name == name:
            return thing
    raise KeyError(name)
