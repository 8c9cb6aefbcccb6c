"""What should run on a computer: containers with their components and connectors.

An agent compares it with what runs, and takes the smallest step, so that saying it
twice is harmless.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from msgspec import Struct
from msgspec.structs import replace

Goal = Literal["inactive", "active", "stay"]
"""What a component should be. `stay`: as it is, and inactive when it is new: so a
container that ends in the middle of a move begins again with nothing of it active."""

Aim = Literal["inactive", "ready", "active", "finalized"]
"""Where a component goes. `ready`: activated, and at rest until it is `active`."""

ConnectorKind = Literal["direct", "local", "remote"]


class ChainPart(Struct, frozen=True, kw_only=True):
    """A chain that a component is part of.

    Parameters
    ----------
    is_first
        Whether the chain's data is made here.
    deadline
        How old its data may be, at the last component [s]; None elsewhere.
    """

    name: str
    is_first: bool = False
    deadline: float | None = None


class ComponentSpec(Struct, frozen=True, kw_only=True):
    """A component that should run: by its class, or by a command line.

    Parameters
    ----------
    command
        Program and arguments; not empty for a component that is any executable.
    epoch
        Counts the incarnations of a component: while it moves or is replaced there
        are two, of which one at most is active.
    adapt
        ``package.module:function`` that maps the state of the incarnation before, when
        that had another implementation; empty: the state is the same.
    instead_of
        The class that the robot file names, when another one replaced it; else empty.
    code
        Tells versions of its implementation's code apart.
    fresh
        Whether it begins without the state of the incarnation before.
    devices
        Device names to paths.
    weigh
        Whether the size of its snapshot is taken when it is deactivated.
    checkpoint
        How often its state is kept, for when its container crashes [s]; 0: never.
    restart_when_hung
        Its container is restarted when its code does not go on for this time [s]; 0:
        that is only said.
    gently
        Whether it is prepared with the CPU time that others leave: they are at work.
    chains
        Those that it is part of.
    leased
        Whether it is inactive while its agent is cut off: it may be active elsewhere.
    held
        Whether it is inactive only until it is known what runs elsewhere; it is no
        target of a migration.
    ends
        The ports with which it says that an action is done, or has failed.
    turn, action
        The number of the action that it is to end, which grows, and its name.
    """

    name: str
    epoch: int = 0
    goal: Goal
    implementation: str = ""
    instead_of: str = ""
    code: str = ""
    command: tuple[str, ...] = ()
    adapt: str = ""
    fresh: bool = False
    parameters: Mapping[str, Any] = {}
    devices: Mapping[str, str] = {}
    weigh: bool = False
    checkpoint: float = 0.0
    restart_when_hung: float = 0.0
    gently: bool = False
    chains: tuple[ChainPart, ...] = ()
    leased: bool = False
    held: bool = False
    ends: tuple[str, ...] = ()
    turn: int = 0
    action: str = ""


class ConnectorSpec(Struct, frozen=True, kw_only=True):
    """A connector that should join two ports; publisher or caller is the source.

    Parameters
    ----------
    name
        Unique in the robot, and the same whatever moves.
    source_epoch, target_epoch
        Which incarnations of the two components it joins.
    source_computer, target_computer
        Where they are.
    address
        Where the target's container is reached (`poise.wire.address.Address`); empty
        for the kind ``direct``.
    limit
        Time limit of a call [s].
    slot
        What the source calls its end. Connectors from one port to architectures that
        are alternatives have the same, so that what waits for one goes to the other.
        Empty: `name`.
    record
        A file for the messages or calls that come; empty: they are not recorded.
    carries, answers
        The chains whose data goes from source to target, and with answers to calls
        from target to source; the same for all connectors of one slot.
    """

    name: str
    slot: str = ""
    kind: ConnectorKind
    source: str
    source_epoch: int = 0
    source_port: str
    source_computer: str = ""
    target: str
    target_epoch: int = 0
    target_port: str
    target_computer: str = ""
    address: str = ""
    limit: float = 1.0
    record: str = ""
    carries: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """What both ends call it on their transport: it changes with every move."""
        return f"{self.name}/{self.source_epoch}.{self.target_epoch}"


class ContainerSpec(Struct, frozen=True, kw_only=True, tag=True):
    """A container that should run: its components, and the connectors at their ports.

    Parameters
    ----------
    folder
        Where implementations are imported from; then come installed packages.
    repository
        Folders where they are looked for last.
    weight
        Its weight when the CPU is not enough for all (cgroups); 0: all are alike.
    nice
        The nice value of its threads where there are no cgroups.
    spare
        It is prepared for an action that has not begun: all such containers together
        get this much CPU [cores] at most, and only what nobody else wants. 0: it gets
        its share.
    """

    name: str
    folder: str
    weight: int = 0
    nice: int = 0
    spare: float = 0.0
    components: tuple[ComponentSpec, ...]
    connectors: tuple[ConnectorSpec, ...]
    repository: tuple[str, ...] = ()

    def without_lease(self) -> ContainerSpec:
        """Return it with its leased components inactive, with their state."""
        components = (
            replace(each, goal="inactive") if each.leased else each
            for each in self.components
        )
        return replace(self, components=tuple(components))

    def is_told_by(self, spec: ContainerSpec) -> bool:
        """Return whether an agent says the same: again, or as its lease ended."""
        return spec in (self, self.without_lease())


class Deployment(Struct, frozen=True, kw_only=True, tag=True):
    """All that should run on one computer. A higher `generation` replaces a lower.

    Parameters
    ----------
    tasks
        What the next manager needs to go on with the robot's tasks; only managers read
        it.
    """

    generation: int
    containers: tuple[ContainerSpec, ...]
    tasks: bytes = b""
