"""The software of a robot: architectures, components, connectors, bridges to ROS 2."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

from msgspec import Struct

from poise.model.file_keys import (
    COMMAND,
    END,
    ENDS,
    PORTS,
    Amount,
    Bytes,
    Cores,
    Name,
    PortKind,
    Rate,
    Reference,
    Resource,
    Seconds,
    Share,
    by_name,
    entries,
    note,
    says,
)
from poise.model.ros2_node import Ros2Node, RosName

Layer = Literal["deliberative", "sequencing", "reactive"]
WhenCutOff = Literal["stop", "go on"]
LONGEST_LIMIT = 7 * 86400.0
"""[s] A longer limit is an error: clocks and locks cannot wait for ever."""
MOST_RATE = 1e6
"""[Hz] A higher rate is an error: no message takes less than a microsecond."""


class DeclaredPort(Struct, frozen=True, kw_only=True):
    """A port as the robot file declares it, for components whose code cannot be read.

    `type` is ``package.module:Class`` of the message or interface.
    """

    name: str
    kind: PortKind
    type: str


class DemandKeys(Struct):
    """How the demand of a component is written."""

    cpu: Annotated[
        Cores | None,
        says(
            "Its demand on the reference computer: 20%, 1.5 cores. Default: from the "
            "profile, else 0."
        ),
    ] = None
    memory: Annotated[
        Bytes | None, says("Its demand: 512 MiB. Default: as for cpu.")
    ] = None
    resources: Annotated[
        Mapping[Resource, Amount], says("Its demand of other resources: {gpu: 1}.")
    ] = {}


class ComponentEntry(Struct, frozen=True, kw_only=True):
    """A unit that has ports, a demand and, when it runs, state.

    Without `implementation`, `command` and `ros2` it is for planning only. A resource
    that neither `demand` nor a profile gives counts as 0.
    """

    name: str
    implementation: Annotated[
        Reference, says("Its Python class: package.module:Class.", is_nullable=True)
    ] = ""
    command: Annotated[
        tuple[str, ...],
        COMMAND,
        says(
            "The command line of a component that is any executable.", is_nullable=True
        ),
    ] = ()
    ros2: Annotated[
        Ros2Node | None, says("The ROS 2 node that it is: an executable, or a class.")
    ] = None
    environment: Annotated[
        Mapping[str, str],
        says("Further environment variables of a command or an executable."),
    ] = {}
    demand: Annotated[Mapping[str, float], entries(DemandKeys)] = {}
    devices: Annotated[
        tuple[Name, ...], says("Devices it needs; it runs where they are.")
    ] = ()
    only: Annotated[
        tuple[Name, ...], says("The computers it may run on; without it, any.")
    ] = ()
    movable: Annotated[bool, says("Whether it may be moved while it runs.")] = True
    isolated: Annotated[bool, says("Whether it gets a container of its own.")] = False
    when_cut_off: Annotated[
        WhenCutOff | None,
        says("What it does while its computer is cut off. Default: the robot's."),
    ] = None
    state: Annotated[
        Bytes,
        says(
            "The size of its state, which a move transfers. Default, and for 0: from "
            "the profile."
        ),
    ] = 0.0
    checkpoint: Annotated[
        Seconds,
        says(
            "How often its state is kept, for when its container crashes or its "
            "computer is lost: 1 s. Default: never.",
            gt=0,
        ),
    ] = 0.0
    restart_when_hung: Annotated[
        Seconds,
        says(
            "Its container is restarted when its code hangs for this time: "
            "5 s. Default: it is only reported.",
            gt=0,
        ),
    ] = 0.0
    ports: Annotated[
        tuple[DeclaredPort, ...],
        PORTS,
        says("Its ports, if no Python class declares them."),
    ] = ()
    parameters: Annotated[
        Mapping[str, Any], says("Passed to it when it is configured.")
    ] = {}


class CodeTimer(Struct, frozen=True):
    """A timer as the class of a component declares it; without a deadline: None [s]."""

    name: str
    period: float
    deadline: float | None


class ComponentCode(Struct, frozen=True, kw_only=True):
    """What the class of a component declares that is no part of the file."""

    timers: tuple[CodeTimer, ...] = ()
    keep: Mapping[str, int] = {}  # subscribed port -> how many messages wait at most
    blocks: tuple[str, ...] = ()  # subscribed ports whose publishers wait for room
    # timer, subscribed or provided port, or "answer" for what takes those of started
    # calls -> the ports that its code may publish or call on
    sends: Mapping[str, tuple[str, ...]] = {}
    # the same -> port of which it only starts calls -> whether it waits for the answers
    starts: Mapping[str, Mapping[str, bool]] = {}
    ports: Mapping[str, PortKind] = {}


class ConnectorEnd(Struct, frozen=True):
    """One end of a connector: a component and one of its ports ("" if not named)."""

    component: str
    port: str = ""

    def __str__(self) -> str:
        return f"{self.component}.{self.port}" if self.port else self.component


class Connector(Struct, frozen=True, kw_only=True, dict=True):
    """Joins two ports.

    A calibrated profile provides the `overhead` that a file does not give
    (`poise.estimate.demands`); without both it is the traffic [MB/s] (the paper's
    "system-dependent value"). `record` is a folder in which messages or calls are
    recorded, set by `poise run --record`; empty: none.
    """

    between: Annotated[
        tuple[ConnectorEnd, ConnectorEnd],
        ENDS,
        says("Publisher or caller first, subscriber or callee second."),
    ]
    overhead: Annotated[
        Amount | None,
        says(
            "Relative overhead when its ends are apart, in hundredths of a core. "
            "Default: from `poise calibrate`, else MB/s."
        ),
    ] = None
    message: Annotated[
        Bytes,
        says(
            "Size of one message or call, both ways together: 1.5 kB. Default, and for "
            "0: from the profile."
        ),
    ] = 0.0
    rate: Annotated[
        Rate,
        says(
            "Messages or calls per second: 10 Hz. Default, and for 0: from the "
            "profile. `overhead: 0` makes it count for nothing.",
            le=MOST_RATE,
        ),
    ] = 0.0
    limit: Annotated[
        Seconds, says("Time limit of a call: 100 ms.", gt=0, le=LONGEST_LIMIT)
    ] = 1.0
    topic: Annotated[
        RosName,
        says(
            "The topic, service or action by which ROS 2 joins them, without ports: it "
            "counts for the placement only.",
            is_nullable=True,
        ),
    ] = ""
    record: str = ""

    @property
    def traffic(self) -> float:
        """Its traffic over a link when its ends are apart [bytes/s]."""
        return self.message * self.rate

    @property
    def cost(self) -> float:
        """Its overhead in the objective: as declared, or else its traffic [MB/s]."""
        return self.traffic / 1e6 if self.overhead is None else self.overhead

    @cached_property
    def name(self) -> str:
        """Its name, at run time, too."""
        return f"{self.between[0]}-{self.between[1]}{self.topic and f' {self.topic}'}"

    def __str__(self) -> str:
        return self.name


class Architecture(Struct, frozen=True, kw_only=True):
    """Provides one function by a set of components and connectors.

    Several architectures may provide the same function. `file` and `package` say where
    one from the repository is from; both are empty for the robot file's own. `success`
    is the share of actions that succeed with it, as learned; it weighs its quality.
    """

    name: str
    function: Annotated[Name, says("The function that it provides.")]
    layer: Annotated[Layer, says("Only components of the sequencing layer move.")] = (
        "sequencing"
    )
    priority: Annotated[
        int,
        says(
            "Under overload the higher get more CPU; the lowest is suspended first "
            "when not all fit.",
            ge=-1000,
            le=1000,
        ),
    ] = 0
    quality: Annotated[
        Share, says("How well it provides its function: above 0, up to 1.", gt=0, le=1)
    ] = 1.0
    home: Annotated[
        Name | None,
        says(
            "The computer on which static placement puts it; required outside the "
            "sequencing layer."
        ),
    ] = None
    exclusive: Annotated[
        bool, says("Whether only one action may use its function at a time.")
    ] = False
    linger: Annotated[
        Seconds | None,
        says(
            "How long it stays prepared when no action needs it any more: 10 s. "
            "Default: as long as what that costs is less than a start."
        ),
    ] = None
    components: Annotated[
        tuple[ComponentEntry, ...],
        by_name(ComponentEntry),
        says("Its components by name.", is_required=True),
    ] = ()
    connectors: Annotated[
        tuple[Connector, ...], says("Connectors between its own components.")
    ] = ()
    file: str = ""
    package: str = ""
    success: float = 1.0


STEP = 10.0
"""How many times more CPU the next higher priority gets, when both want all."""
RANGE = 100.0
"""How many times more the highest gets than the lowest, at most."""


def importance(priorities: Iterable[int]) -> dict[int, float]:
    """Return priority -> how many times as much as the lowest it counts, by order."""
    ranked = sorted(set(priorities))
    steps = len(ranked) - 1
    step = min(STEP, RANGE ** (1 / steps)) if steps > 0 else 1.0
    return {priority: step**rank for rank, priority in enumerate(ranked)}


_WORD = r"[A-Za-z][A-Za-z0-9_]*"
RosType = Annotated[
    str,
    note(
        pattern=rf"^{_WORD}/(msg|srv|action)/{_WORD}$",
        expected="package/msg/Name, package/srv/Name or package/action/Name",
        examples=("sensor_msgs/msg/LaserScan", "std_srvs/srv/Trigger"),
    ),
]
Reliability = Literal["reliable", "best effort"]
Durability = Literal["volatile", "transient local"]
Discovery = Literal["subnet", "localhost", "computers"]


class Ros2Bridge(Struct, frozen=True, kw_only=True):
    """Joins a port of a component with a topic, a service or an action of ROS 2.

    The port says the direction: what is published goes to ROS 2, what is subscribed
    comes from there; provided methods are served to ROS 2, required ones are asked
    there.
    """

    ros2: Annotated[RosName, says("The topic, service or action: /scan.")]
    port: Annotated[ConnectorEnd, END, says("The component's port: scanner.scan.")]
    method: Annotated[
        Name, says("The method of an interface with several.", is_nullable=True)
    ] = ""
    type: Annotated[
        RosType,
        says(
            "Its type in ROS 2: sensor_msgs/msg/LaserScan. Default: the only one that "
            "is called as the port's message or interface.",
            is_nullable=True,
        ),
    ] = ""
    reliability: Annotated[
        Reliability | None, says("Default: as the other side's; if unknown, reliable.")
    ] = None
    durability: Annotated[
        Durability | None,
        says("Default: transient local for a port that keeps its last message."),
    ] = None
    depth: Annotated[int, says("How many messages wait at most.", ge=1, le=10000)] = 10
    limit: Annotated[
        Seconds, says("Time limit of a call or an action.", gt=0, le=LONGEST_LIMIT)
    ] = 1.0


class Ros2Network(Struct, frozen=True, kw_only=True):
    """How the robot's ROS 2 nodes find each other."""

    domain: Annotated[
        int | None, says("ROS_DOMAIN_ID. Default: that of `poise agent`.", ge=0, le=232)
    ] = None
    discovery: Annotated[
        Discovery | None,
        says(
            "Where nodes look for others: in the subnet by multicast, on their own "
            "computer, or on the computers of the robot file, without multicast. "
            "Default: as the environment of `poise agent` says."
        ),
    ] = None
    bridges: Annotated[
        tuple[Ros2Bridge, ...], says("Ports of components that are joined with ROS 2.")
    ] = ()
