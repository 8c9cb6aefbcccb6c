"""The records of a robot: pure, frozen, in SI units.

`poise.model.load` reads them from a robot file. Names are unique within their kind;
names of components are unique in the whole robot. Resources have any names; ``cpu``
[cores of the reference computer] and ``memory`` [bytes] always exist.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal, Protocol, TypeVar

from msgspec import Struct

Layer = Literal["deliberative", "sequencing", "reactive"]
Scale = Literal["normalised", "paper"]
Spread = Literal["range", "variance"]
Arrivals = Literal["regular", "poisson"]
PortKind = Literal["provides", "requires", "publishes", "subscribes"]


class Computer(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A computer of the robot (the paper's SBC).

    Parameters
    ----------
    capacity
        Resource -> amount [cores, bytes, or the resource's own unit], before `speed`.
    speed
        How fast one core is, relative to the reference computer; > 0. It scales
        ``cpu`` capacity only.
    reserve
        Resource -> share of the capacity that placements leave free, in [0, 1).
    price
        What it costs, in any unit; the smallest set of computers is the cheapest.
    address
        Host name or IP address of its agent, or None when it is to be emulated.
    """

    name: str
    capacity: Mapping[str, float] = {}
    speed: float = 1.0
    reserve: Mapping[str, float] = {}
    price: float = 1.0
    address: str | None = None

    def usable(self, resource: str) -> float:
        """Return the usable amount of `resource`: capacity x speed - reserve."""
        speed = self.speed if resource == "cpu" else 1.0
        return (
            self.capacity.get(resource, 0.0)
            * speed
            * (1 - self.reserve.get(resource, 0.0))
        )


class Device(Struct, frozen=True, kw_only=True):
    """A sensor or actuator, fixed to one computer.

    `path` is passed to the components that need the device: a device node, a socket.
    """

    name: str
    computer: str
    path: str = ""


class Link(Struct, frozen=True, kw_only=True):
    """A network link between two computers.

    Parameters
    ----------
    bandwidth
        [bytes/s], each way; infinite when the file gives none.
    latency
        One way [s].
    distance
        What a unit of overhead costs over this link in the objective; >= 0.
    """

    between: tuple[str, str]
    bandwidth: float = float("inf")
    latency: float = 0.0
    distance: float = 1.0


class DeclaredPort(Struct, frozen=True, kw_only=True):
    """A port as the robot file declares it, for components whose code cannot be read.

    `type` is ``package.module:Class`` of the message or interface.
    """

    name: str
    kind: PortKind
    type: str


class Component(Struct, frozen=True, kw_only=True):
    """A unit that has ports, a demand and, when it runs, state.

    Parameters
    ----------
    implementation
        ``package.module:Class``; empty when `command` is given, or for planning only.
    command
        The command line of a component that is any executable.
    demand
        Resource -> amount on the reference computer [cores, bytes, ...]. A resource
        that neither the robot file nor a profile gives counts as 0.
    devices
        Names of the devices it needs; it runs where all of them are.
    only
        The computers it may run on; empty means any.
    movable
        Whether it may be moved while it runs.
    isolated
        Whether it gets a container of its own.
    state
        Size of its snapshot [bytes].
    parameters
        Passed to the component when it is configured.
    """

    name: str
    implementation: str = ""
    command: tuple[str, ...] = ()
    demand: Mapping[str, float] = {}
    devices: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    movable: bool = True
    isolated: bool = False
    state: float = 0.0
    ports: tuple[DeclaredPort, ...] = ()
    parameters: Mapping[str, Any] = {}


class End(Struct, frozen=True):
    """One end of a connector: a component and one of its ports ("" if not named)."""

    component: str
    port: str = ""

    def __str__(self) -> str:
        return f"{self.component}.{self.port}" if self.port else self.component


class Connector(Struct, frozen=True, kw_only=True):
    """Joins two ports: publisher or caller first, subscriber or callee second.

    Parameters
    ----------
    overhead
        Relative overhead when its ends are on different computers; a calibrated profile
        provides it (`poise.estimate.overhead`). None: the traffic [MB/s] (the paper's
        "system-dependent value").
    message
        Size of one message or call, both ways together [bytes].
    rate
        Messages or calls per second [1/s].
    limit
        Time limit of a call [s]; > 0.
    record
        A file in which messages or calls are recorded; empty: none. Set by
        `poise run --record`, not by the robot file.
    """

    between: tuple[End, End]
    overhead: float | None = None
    message: float = 0.0
    rate: float = 0.0
    limit: float = 1.0
    record: str = ""

    @property
    def traffic(self) -> float:
        """Its traffic over a link when its ends are apart [bytes/s]."""
        return self.message * self.rate

    @property
    def cost(self) -> float:
        """Its overhead in the objective: as declared, or else its traffic [MB/s]."""
        return self.traffic / 1e6 if self.overhead is None else self.overhead

    def __str__(self) -> str:
        return f"{self.between[0]} -> {self.between[1]}"


class Architecture(Struct, frozen=True, kw_only=True):
    """A sub-architecture: provides one function by a set of components.

    Parameters
    ----------
    function
        The function that it provides; several architectures may provide the same.
    layer
        Only components of the sequencing layer move (paper, section II-A).
    priority
        The architecture with the lowest priority is dropped first when not all fit.
    quality
        How well it provides its function, in (0, 1].
    home
        The computer on which static placement puts it.
    """

    name: str
    function: str
    layer: Layer = "sequencing"
    priority: int = 0
    quality: float = 1.0
    home: str | None = None
    components: tuple[Component, ...] = ()
    connectors: tuple[Connector, ...] = ()


class Chain(Struct, frozen=True, kw_only=True):
    """An end-to-end deadline [s] over a chain of components, first to last."""

    name: str
    through: tuple[str, ...]
    deadline: float


class Action(Struct, frozen=True, kw_only=True):
    """A step of a task: the functions it needs, by name."""

    name: str
    functions: tuple[str, ...]


class Task(Struct, frozen=True, kw_only=True):
    """A sequence of actions."""

    name: str
    actions: tuple[Action, ...]

    @property
    def functions(self) -> tuple[str, ...]:
        """All functions that its actions need, each once, in order."""
        return tuple(dict.fromkeys(f for a in self.actions for f in a.functions))


class Objective(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The weights of F (docs/design/objective.md); all finite and >= 0.

    Parameters
    ----------
    communication, balance
        The paper's omega_1 and omega_2.
    weights
        Resource -> weight of its spread in the balance term.
    sizes
        Resource -> weight in a component's size, by which the greedy orders.
    """

    communication: float = 0.5
    balance: float = 0.5
    scale: Scale = "normalised"
    spread: Spread = "range"
    weights: Mapping[str, float] = {}
    sizes: Mapping[str, float] = {}


class Simulator(Struct, frozen=True, kw_only=True):
    """The simulated world of an emulated robot: a command line.

    It runs outside every emulated computer's limits, with the run's folder in the
    environment variable ``POISE_RUN``; devices' paths are relative to that folder. The
    last line it prints is a JSON object that goes into the run's report.
    """

    command: tuple[str, ...]


class Generated(Struct, frozen=True, kw_only=True):
    """Messages that are generated for a subscribed port.

    Parameters
    ----------
    rate
        On average [1/s]; > 0.
    arrivals
        ``regular``: at equal distances; ``poisson``: at random ones.
    size
        Mean encoded size [bytes]; 0: as small as can be.
    variation
        Sizes vary evenly within this share of `size`, in [0, 1).
    message
        ``package.module:function`` that makes one; empty: fields are filled at random.
    """

    port: End
    rate: float
    arrivals: Arrivals = "regular"
    size: float = 0.0
    variation: float = 0.0
    message: str = ""
    seed: int = 0


class Workload(Struct, frozen=True, kw_only=True):
    """The input of components while they are measured.

    Parameters
    ----------
    command
        Runs instead of the simulator; empty: the simulator does.
    recording
        File of a recording, relative to the robot's folder; empty: none.
    """

    command: tuple[str, ...] = ()
    recording: str = ""
    generate: tuple[Generated, ...] = ()


class Robot(Struct, frozen=True, kw_only=True):
    """The whole robot.

    Parameters
    ----------
    connectors
        Connectors between components of different architectures.
    together, apart
        Sets of components that must share a computer, or must not.
    quality_weight
        What F grows by for every unit of quality lost by choosing an architecture
        that is not the best one for its function; >= 0.
    workload
        Input of components while they are profiled; None: from the simulator and the
        other components.
    profile
        The profile's file, relative to `folder`; empty when there is none.
    folder
        Folder of the robot file, from which implementations are imported.
    """

    name: str
    computers: tuple[Computer, ...] = ()
    devices: tuple[Device, ...] = ()
    links: tuple[Link, ...] = ()
    architectures: tuple[Architecture, ...] = ()
    connectors: tuple[Connector, ...] = ()
    chains: tuple[Chain, ...] = ()
    tasks: tuple[Task, ...] = ()
    objective: Objective = Objective()
    quality_weight: float = 1.0
    together: tuple[tuple[str, ...], ...] = ()
    apart: tuple[tuple[str, ...], ...] = ()
    simulator: Simulator | None = None
    workload: Workload | None = None
    profile: str = ""
    folder: str = ""

    def components(self) -> Iterator[Component]:
        """Yield every component of every architecture."""
        for architecture in self.architectures:
            yield from architecture.components

    def all_connectors(self) -> Iterator[Connector]:
        """Yield every connector, inside architectures first, then between them."""
        for architecture in self.architectures:
            yield from architecture.connectors
        yield from self.connectors

    def task(self, name: str) -> Task:
        """Return the task called `name`; KeyError when there is none."""
        return _named(self.tasks, name)

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
