"""The sections of a robot file as people write them: the source of its schema.

The validator (`poise.model.yaml.validate`), the published JSON Schema
(`poise.model.schema`) and the records that `poise.model.build` reads all come from
these types. A description here is what an editor shows.
"""

from __future__ import annotations

import shlex
from typing import Annotated, Any, get_args

from msgspec import Meta, Struct

from poise import units
from poise.model.robot import Arrivals, Layer, PortKind, Scale, Spread

_NAME = r"[A-Za-z][A-Za-z0-9_-]{0,62}"
_NAME_SAYS = "a letter, then up to 62 letters, digits, '_' or '-'"


def _quantity(dimension: units.Dimension) -> Meta:
    """Return the dimension of a number, for the validator and the schema."""
    return Meta(
        extra={"dimension": dimension.name},
        extra_json_schema={
            "x-dimension": dimension.name,
            "examples": dimension.example.split(" or "),
        },
    )


def _command_line(text: str) -> None:
    """Raise ValueError when a command line cannot be split as a shell does."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ValueError(
            f"{units.quoted(text)} is not a command line: {error}"
        ) from None
    if not words:
        raise ValueError("is empty")


def _says(text: str) -> Meta:
    return Meta(description=text)


Name = Annotated[
    str,
    Meta(
        pattern=f"^{_NAME}$",
        examples=["main", "laser_scanner"],
        extra={"expected": _NAME_SAYS},
    ),
]
Resource = Annotated[
    str,
    Meta(
        pattern=rf"^(?!(cpu|memory)$){_NAME}$",
        examples=["gpu"],
        extra={
            "expected": f"{_NAME_SAYS}; cpu and memory have keys of their own",
        },
    ),
]
Reference = Annotated[
    str,
    Meta(
        pattern=r"^\w+(\.\w+)*:\w+(\.\w+)*$",
        examples=["package.module:Class"],
        extra={"expected": "package.module:Class"},
    ),
]
End = Annotated[
    str,
    Meta(
        pattern=rf"^{_NAME}(\.\w{{1,63}})?$",
        examples=["localiser.scan"],
        extra={"expected": "component.port, or only component"},
    ),
]
Cores = Annotated[float, _quantity(units.CORES)]
Bytes = Annotated[float, _quantity(units.BYTES)]
Seconds = Annotated[float, _quantity(units.SECONDS)]
Rate = Annotated[float, _quantity(units.RATE)]
Bandwidth = Annotated[float, _quantity(units.BANDWIDTH)]
Share = Annotated[float, _quantity(units.RATIO)]
Amount = Annotated[float, _quantity(units.NUMBER)]
Address = Annotated[str, Meta(examples=["10.0.0.1", "[fd00::2]:7447"])]
CommandLine = Annotated[str, Meta(min_length=1, extra={"parse": _command_line})]
Command = CommandLine | Annotated[list[str], Meta(min_length=1)]


class Section(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every mapping in the file that has fixed keys."""


class ComputerSection(Section, frozen=True, kw_only=True):
    """A computer of the robot and its capacity."""

    cpu: Annotated[Cores, Meta(gt=0), _says("Its cores: 4, or 150%.")]
    memory: Annotated[Bytes, Meta(gt=0), _says("Its memory for components: 1 GiB.")]
    resources: Annotated[
        dict[Resource, Amount],
        _says("Any other resource that components share, by name: {gpu: 1}."),
    ] = {}
    speed: Annotated[
        Amount,
        Meta(gt=0),
        _says("How fast one core is; the reference computer's are 1."),
    ] = 1.0
    reserve: Annotated[
        Annotated[Share, Meta(lt=1)] | dict[Name, Annotated[Share, Meta(lt=1)]],
        _says(
            "The share that placements leave free: 5% of cpu and memory, or by "
            "resource, as in {cpu: 5%, disk: 10%}."
        ),
    ] = 0.0
    price: Annotated[
        Amount,
        _says("What it costs, in any unit; `poise plan --smallest` seeks the least."),
    ] = 1.0
    address: Annotated[
        Address | None,
        _says("Host or host:port of its agent. Without it the computer is emulated."),
    ] = None


class DeviceSection(Section, frozen=True, kw_only=True):
    """A sensor or actuator, fixed to one computer."""

    computer: Annotated[Name, _says("The computer that it is plugged into.")]
    path: Annotated[
        str,
        _says("A device node, or a socket of the simulator, for its components."),
    ] = ""


class LinkSection(Section, frozen=True, kw_only=True):
    """A network link between two computers."""

    between: Annotated[tuple[Name, Name], _says("The two computers it joins.")]
    bandwidth: Annotated[
        Annotated[Bandwidth, Meta(gt=0)] | None,
        _says("Each way: 100 Mbit/s. Without it there is no limit."),
    ] = None
    latency: Annotated[Seconds, _says("One way: 0.2 ms.")] = 0.0
    distance: Annotated[
        Amount, _says("Cost of a unit of overhead over it in the objective.")
    ] = 1.0


class ComponentSection(Section, frozen=True, kw_only=True):
    """A unit that has ports, a demand and, when it runs, state."""

    implementation: Annotated[
        Reference | None, _says("Its Python class: package.module:Class.")
    ] = None
    command: Annotated[
        Command | None,
        _says("The command line of a component that is any executable."),
    ] = None
    cpu: Annotated[
        Cores | None,
        _says(
            "Its demand on the reference computer: 20%, 1.5 cores. Default: from the "
            "profile, else 0."
        ),
    ] = None
    memory: Annotated[
        Bytes | None, _says("Its demand: 512 MiB. Default: as for cpu.")
    ] = None
    resources: Annotated[
        dict[Resource, Amount], _says("Its demand of other resources: {gpu: 1}.")
    ] = {}
    devices: Annotated[
        list[Name], _says("Devices it needs; it runs where they are.")
    ] = []
    only: Annotated[
        list[Name], _says("The computers it may run on; without it, any.")
    ] = []
    movable: Annotated[bool, _says("Whether it may be moved while it runs.")] = True
    isolated: Annotated[bool, _says("Whether it gets a container of its own.")] = False
    state: Annotated[Bytes, _says("The size of its state, which a move transfers.")] = (
        0.0
    )
    ports: Annotated[
        dict[
            Annotated[str, Meta(pattern=r"^\w{1,63}$")],
            Annotated[
                dict[PortKind, Reference],
                Meta(
                    min_length=1,
                    max_length=1,
                    extra_json_schema={"propertyNames": {"enum": get_args(PortKind)}},
                ),
            ],
        ],
        _says("Its ports, if no Python class declares them."),
    ] = {}
    parameters: Annotated[
        dict[str, Any], _says("Passed to it when it is configured.")
    ] = {}


class ConnectorSection(Section, frozen=True, kw_only=True):
    """Joins two ports."""

    between: Annotated[
        tuple[End, End],
        _says("Publisher or caller first, subscriber or callee second."),
    ]
    overhead: Annotated[
        Amount | None,
        _says(
            "Relative overhead when its ends are apart, in hundredths of a core. "
            "Default: from `poise calibrate`, else MB/s."
        ),
    ] = None
    message: Annotated[
        Bytes, _says("Size of one message or call, both ways together: 1.5 kB.")
    ] = 0.0
    rate: Annotated[Rate, _says("Messages or calls per second: 10 Hz.")] = 0.0
    limit: Annotated[
        Annotated[Seconds, Meta(gt=0)], _says("Time limit of a call: 100 ms.")
    ] = 1.0


class ArchitectureSection(Section, frozen=True, kw_only=True):
    """Provides one function by a set of components and connectors."""

    function: Annotated[Name, _says("The function that it provides.")]
    layer: Annotated[Layer, _says("Only components of the sequencing layer move.")] = (
        "sequencing"
    )
    priority: Annotated[
        Annotated[int, Meta(ge=-1000, le=1000)],
        _says("The lowest is dropped first when not all fit."),
    ] = 0
    quality: Annotated[
        Annotated[Share, Meta(gt=0, le=1)],
        _says("How well it provides its function: above 0, up to 1."),
    ] = 1.0
    home: Annotated[
        Name | None, _says("The computer on which static placement puts it.")
    ] = None
    components: Annotated[
        dict[Name, ComponentSection], _says("Its components by name.")
    ]
    connectors: Annotated[
        list[ConnectorSection], _says("Connectors between its own components.")
    ] = []


class ChainSection(Section, frozen=True, kw_only=True):
    """An end-to-end deadline over a chain of components."""

    through: Annotated[
        list[Name], Meta(min_length=2), _says("The components, first to last.")
    ]
    deadline: Annotated[Annotated[Seconds, Meta(gt=0)], _says("200 ms.")]


class ActionSection(Section, frozen=True, kw_only=True):
    """A step of a task."""

    name: Annotated[Name, _says("What the step is called.")]
    functions: Annotated[list[Name], _says("The functions that it needs.")]


class TaskSection(Section, frozen=True, kw_only=True):
    """A sequence of actions."""

    actions: Annotated[list[ActionSection], Meta(min_length=1), _says("In order.")]


class ObjectiveSection(Section, frozen=True, kw_only=True):
    """The weights of a good placement."""

    communication: Annotated[
        Amount, _says("Weight of the communication between computers.")
    ] = 0.5
    balance: Annotated[
        Amount, _says("Weight of how unevenly the free capacity is spread.")
    ] = 0.5
    scale: Annotated[
        Scale, _says("Shares of capacity and of all overhead, or raw units.")
    ] = "normalised"
    spread: Annotated[
        Spread, _says("Largest minus smallest residue, or its population variance.")
    ] = "range"
    weights: Annotated[
        dict[Name, Amount], _says("Weight of each resource in the balance.")
    ] = {}
    sizes: Annotated[
        dict[Name, Amount], _says("Weight of each resource in a component's size.")
    ] = {}
    quality: Annotated[
        Amount, _says("Weight of the quality lost by a lesser alternative.")
    ] = 1.0


class SimulatorSection(Section, frozen=True, kw_only=True):
    """The simulated world of an emulated robot."""

    command: Annotated[Command, _says("Its command line.")]


class GeneratedSection(Section, frozen=True, kw_only=True):
    """Messages that are generated for a port while components are measured."""

    rate: Annotated[Annotated[Rate, Meta(gt=0)], _says("On average: 10 Hz.")]
    arrivals: Annotated[
        Arrivals, _says("At equal distances, or at random ones (Poisson).")
    ] = "regular"
    size: Annotated[
        Bytes, _says("Mean size, encoded: 1.5 kB. Without it, as small as can be.")
    ] = 0.0
    variation: Annotated[
        Annotated[Share, Meta(lt=1)],
        _says("Sizes vary evenly within this share of the mean: 20%."),
    ] = 0.0
    message: Annotated[
        Reference | None,
        _says(
            "package.module:function that makes a message of a random.Random and a "
            "size [bytes]; without it, its fields are filled at random."
        ),
    ] = None
    seed: Annotated[int, _says("The same seed makes the same messages.")] = 0


class WorkloadSection(Section, frozen=True, kw_only=True):
    """What components work on while `poise profile` measures them."""

    command: Annotated[
        Command | None, _says("A command line that runs instead of the simulator.")
    ] = None
    recording: Annotated[
        str | None,
        _says(
            "A file of `poise run --record`, relative to this one: what other "
            "architectures published then comes from there."
        ),
    ] = None
    generate: Annotated[
        dict[End, GeneratedSection],
        _says("Subscribed component.port -> messages that are generated for it."),
    ] = {}


class RobotSection(Section, frozen=True, kw_only=True):
    """A robot: its computers, its software and its tasks."""

    robot: Annotated[Name, _says("The robot's name.")]
    include: Annotated[
        list[str], _says("Further files, relative to this one; sections are merged.")
    ] = []
    computers: Annotated[
        dict[Name, ComputerSection], Meta(min_length=1), _says("The computers by name.")
    ]
    devices: Annotated[dict[Name, DeviceSection], _says("Sensors and actuators.")] = {}
    links: Annotated[list[LinkSection], _says("Network links between computers.")] = []
    architectures: Annotated[
        dict[Name, ArchitectureSection], _says("The software, one entry per function.")
    ] = {}
    connectors: Annotated[
        list[ConnectorSection], _says("Connectors between architectures.")
    ] = []
    chains: Annotated[dict[Name, ChainSection], _says("End-to-end deadlines.")] = {}
    tasks: Annotated[dict[Name, TaskSection], _says("The tasks of the robot.")] = {}
    objective: Annotated[
        ObjectiveSection, _says("The weights of a good placement.")
    ] = ObjectiveSection()
    together: Annotated[
        list[Annotated[list[Name], Meta(min_length=2)]],
        _says("Sets of components that share a computer."),
    ] = []
    apart: Annotated[
        list[Annotated[list[Name], Meta(min_length=2)]],
        _says("Sets of components that are on different computers."),
    ] = []
    simulator: Annotated[
        SimulatorSection | None, _says("The simulated world of an emulated robot.")
    ] = None
    workload: Annotated[
        WorkloadSection | None,
        _says("What components work on while `poise profile` measures them."),
    ] = None
    profile: Annotated[
        str | None,
        _says(
            "The file, relative to this one, that `poise profile` writes; demands, "
            "states and traffic that are not given here come from it."
        ),
    ] = None
