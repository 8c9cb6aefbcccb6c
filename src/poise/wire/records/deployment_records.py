"""What should run on a computer: containers, their components and connectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from msgspec import Struct
from msgspec.structs import replace

Goal = Literal["inactive", "active", "stay"]
"""What a component should be. `stay`: as it is, and inactive when it is new: so a
container that ends in the middle of a move begins again with nothing of it active."""

LifeCycleGoal = Literal["inactive", "ready", "active", "finalized"]
"""Where a container brings a component. `ready`: activated, and paused until it is
`active`."""

ConnectorKind = Literal["direct", "local", "remote"]


class ChainPart(Struct, frozen=True, kw_only=True):
    """A chain that a component is part of."""

    name: str
    is_first: bool = False  # Whether the chain's data is made here
    # How old its data may be, at the last component [s]; None elsewhere
    deadline: float | None = None


class ComponentSpec(Struct, frozen=True, kw_only=True):
    """A component that should run: by its class, or by a command line."""

    name: str
    # Counts the incarnations of a component: while it moves or is replaced there are
    # two, of which one at most is active
    epoch: int = 0
    goal: Goal
    implementation: str = ""
    # The class that the robot file names, when another one replaced it; else empty
    instead_of: str = ""
    code: str = ""  # Tells versions of its implementation's code apart
    # Program and arguments; not empty for a component that is any executable
    command: tuple[str, ...] = ()
    environment: Mapping[str, str] = {}  # Further variables of the command
    # ``package.module:function`` that maps the state of the incarnation before, when
    # that had another implementation; empty: the state is the same
    adapt: str = ""
    fresh: bool = False  # Whether it begins without the state of the incarnation before
    parameters: Mapping[str, Any] = {}
    changed_parameters: Mapping[str, Any] = {}  # Those that were set since the start
    devices: Mapping[str, str] = {}  # Device names to paths
    # Whether the size of its snapshot is taken when it is deactivated
    weigh: bool = False
    # How often its state is kept, for when its container crashes [s]; 0: never
    checkpoint: float = 0.0
    # Its container is restarted when its code does not go on for this time [s]; 0: that
    # is only said
    restart_when_hung: float = 0.0
    # Whether it is prepared with the CPU time that others leave: they are at work
    gently: bool = False
    # Whether its predecessor is at work until it takes over
    follows: bool = False
    chains: tuple[ChainPart, ...] = ()  # Those that it is part of
    # Whether it is inactive while its agent is cut off: it may be active elsewhere
    leased: bool = False
    # Whether it is inactive only until the other computers are known; it is no target
    # of a migration
    held: bool = False
    # The ports with which it says that an action is done, or has failed
    ends: tuple[str, ...] = ()
    # The actions that it is to end, the last begun last: number and name
    actions: Mapping[int, str] = {}

    @property
    def key(self) -> tuple[str, int]:
        """Name and epoch, which tell it from all other incarnations."""
        return self.name, self.epoch


class ConnectorSpec(Struct, frozen=True, kw_only=True):
    """A connector that should join two ports; publisher or caller is the source."""

    name: str  # Unique in the robot, and the same whatever moves
    # What the source calls its end. Connectors from one port to architectures that are
    # alternatives have the same, so that what waits for one goes to the other. Empty:
    # `name`
    slot: str = ""
    kind: ConnectorKind
    source: str
    # Which incarnations of the two components it joins
    source_epoch: int = 0
    source_port: str
    # Where they are
    source_computer: str = ""
    target: str
    target_epoch: int = 0
    target_port: str
    target_computer: str = ""
    # Where the target's container is reached (`poise.wire.address.Address`); empty for
    # the kind ``direct``
    address: str = ""
    limit: float = 1.0  # Time limit of a call [s]
    # A folder for the messages or calls that come; empty: they are not recorded
    record: str = ""
    # The chains whose data goes from source to target, and with answers to calls from
    # target to source; the same for all connectors of one slot
    carries: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """What both ends call it on their transport: it changes with every move."""
        return f"{self.name}/{self.source_epoch}.{self.target_epoch}"


class ContainerSpec(Struct, frozen=True, kw_only=True, tag=True):
    """A container that should run: its components, and their connectors."""

    name: str
    folder: str  # Where implementations are imported from; then come installed packages
    # Its weight when the CPU is not enough for all (cgroups); 0: all are alike
    weight: int = 0
    nice: int = 0  # The nice value of its threads where there are no cgroups
    # It is prepared for an action that has not begun: all such containers together get
    # this much CPU [cores] at most, and only what nobody else wants. 0: it gets its
    # share
    preparation_cpu: float = 0.0
    components: tuple[ComponentSpec, ...]
    connectors: tuple[ConnectorSpec, ...]
    repository: tuple[str, ...] = ()  # Folders where they are looked for last
    # The version of deployed code that is imported instead of `folder` and
    # `repository`, which are empty then; empty: none is
    code: str = ""

    def without_lease(self) -> ContainerSpec:
        """Return it with its leased components inactive, with their state."""
        components = (
            replace(component, goal="inactive") if component.leased else component
            for component in self.components
        )
        return replace(self, components=tuple(components))

    def agrees_with(self, spec: ContainerSpec) -> bool:
        """Return whether an agent says the same: again, or as its lease ended."""
        return spec in (self, self.without_lease())


class Deployment(Struct, frozen=True, kw_only=True, tag=True):
    """All that should run on one computer. A higher `generation` replaces a lower."""

    generation: int
    containers: tuple[ContainerSpec, ...]
    # The versions of code that the robot runs, here or on other computers
    code: tuple[str, ...] = ()
    # What the next manager needs to go on with: the encoded `Desired`, which only
    # managers read
    desired: bytes = b""
    # The term of the manager that wrote it: of two, the one with the higher term counts
    term: int = 0
    # Whether the robot is being stopped: no standby follows its leader
    is_last: bool = False

    @property
    def components(self) -> tuple[ComponentSpec, ...]:
        """The components of all containers."""
        return tuple(c for container in self.containers for c in container.components)
