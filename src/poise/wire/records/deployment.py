"""What manager, agents and containers tell each other.

Downwards goes what *should* be (`Deployment`, `ContainerSpec`), upwards what *is*
(`AgentStatus`, `ContainerStatus`). Each receiver compares the two and takes the
smallest step, so that saying a thing twice is harmless. The steps of migrations
stand in `poise.wire.records.migration`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Literal

from msgspec import Struct

from poise.wire.records.clocks import Clocks, ClockStatus
from poise.wire.records.migration import MigrationSteps, StepsDone, StepsFailed

PROTOCOL = 6
"""Manager, agents and containers of different protocol versions refuse each other."""

Goal = Literal["inactive", "active", "stay"]
"""What a component should be. `stay`: as it is, and inactive when it is new: so a
container that ends in the middle of a move begins again with nothing of it active."""
Aim = Literal["inactive", "ready", "active", "finalized"]
"""Where a component goes. `ready`: activated, and at rest until it is `active`."""
State = Literal[
    "unconfigured", "inactive", "active", "finalized", "failed", "unresponsive"
]
"""Where a component is. `unresponsive`: its agent says so, because its container does
not respond."""
ContainerState = Literal["starting", "running", "unresponsive", "restarting", "stopped"]
ConnectorKind = Literal["direct", "local", "remote"]
Side = Literal["source", "target", "both"]


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
    fresh
        Whether it begins without the state of the incarnation before.
    devices
        Device names to paths.
    weigh
        Whether the size of its snapshot is taken when it is deactivated.
    gently
        Whether it is prepared with the CPU time that others leave: they are at work.
    """

    name: str
    epoch: int = 0
    goal: Goal
    implementation: str = ""
    command: tuple[str, ...] = ()
    adapt: str = ""
    fresh: bool = False
    parameters: Mapping[str, Any] = {}
    devices: Mapping[str, str] = {}
    weigh: bool = False
    gently: bool = False


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

    @property
    def key(self) -> str:
        """What both ends call it on their transport: it changes with every move."""
        return f"{self.name}/{self.source_epoch}.{self.target_epoch}"


class ContainerSpec(Struct, frozen=True, kw_only=True, tag=True):
    """A container that should run: its components, and the connectors at their ports.

    `folder` is where implementations are imported from.
    """

    name: str
    folder: str
    components: tuple[ComponentSpec, ...]
    connectors: tuple[ConnectorSpec, ...]


class Deployment(Struct, frozen=True, kw_only=True, tag=True):
    """All that should run on one computer. A higher `generation` replaces a lower."""

    generation: int
    containers: tuple[ContainerSpec, ...]


class ManagerId(Struct, frozen=True, kw_only=True):
    """One start of a manager.

    Parameters
    ----------
    key
        Unique; its liveliness token is ``poise/ROBOT/manager/KEY``.
    user, host, pid
        Where it runs, for people.
    since
        When it started [s since 1970].
    """

    key: str
    user: str
    host: str
    pid: int
    since: float

    def __str__(self) -> str:
        """Return who it is, for people."""
        began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        return f"user {self.user} on {self.host} (process {self.pid}) since {began}"


class Claim(Struct, frozen=True, tag=True):
    """Obey this manager from now on."""

    manager: ManagerId


class Accepted(Struct, frozen=True, tag=True):
    """An agent's answer: it obeys the manager, or works towards its deployment."""


class Refused(Struct, frozen=True, tag=True):
    """An agent's answer: it changed nothing, and why."""

    reason: str


Answer = Accepted | Refused | StepsDone | StepsFailed

Request = Claim | Deployment | MigrationSteps
"""What a manager asks of an agent."""


class ManagerRequest(Struct, frozen=True, kw_only=True):
    """A request with its manager's fencing token.

    Each manager claims its agents with a token above all that they have seen. An agent
    refuses deployments and steps with any other token than that of the manager which
    it obeys: what a replaced manager still sends has no effect.
    """

    protocol: int = PROTOCOL
    token: int
    request: Request


class Summary(Struct, frozen=True):
    """Many values of one measurement, in its own unit."""

    count: int = 0
    mean: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    maximum: float = 0.0


class TimerStatus(Struct, frozen=True, kw_only=True):
    """How a timer kept its rate.

    Parameters
    ----------
    releases
        How often it was due since activation.
    missed
        How many of these ended after their deadline, or never began.
    lateness, duration
        From release to start, and from start to end [s].
    """

    name: str
    period: float
    deadline: float | None
    releases: int
    missed: int
    lateness: Summary
    duration: Summary


class ConnectorStatus(Struct, frozen=True, kw_only=True):
    """What one end of a connector counted, since its component began to run there.

    So after a move or a replacement of the target alone, its end counts from 0, and the
    source's goes on.

    Parameters
    ----------
    end
        Where calls and messages begin (``source``), where they end (``target``), or
        ``both`` in one container: then all is counted once.
    bytes_out, bytes_in
        What left this end over a wire, and what came to it [bytes]: at the source
        requests and messages go out and answers come in, at the target the other way
        round. None within a container.
    errors
        Calls that failed, and what came and was refused.
    drops
        Messages that this end gave up: they could not go out, found no room, or made
        room for newer ones.
    delay
        Of calls [s]: at the source there and back, at the target until the answer.
    wait
        Of messages [s]: at the source until they went out, elsewhere from their arrival
        until the component took them.
    size
        Of calls, both ways, and of messages, over a wire [bytes].
    latency
        From the other end to this one [s]: at the target how long calls and messages
        were under way, at the source answers. Over a wire only.
    latency_error
        How far that is off at most, in the mean [s]: nobody knows better how far other
        computers' clocks are ahead. 0 on one computer.
    """

    name: str
    kind: ConnectorKind
    end: Side
    ready: bool
    calls: int = 0
    messages: int = 0
    bytes_out: int = 0
    bytes_in: int = 0
    errors: int = 0
    drops: int = 0
    delay: Summary = Summary()
    wait: Summary = Summary()
    size: Summary = Summary()
    latency: Summary = Summary()
    latency_error: float = 0.0


class ErrorCount(Struct, frozen=True, kw_only=True):
    """Errors of one type that one line of a component's code raised.

    Parameters
    ----------
    where
        The hook, timer or port whose code raised them.
    text
        The first one's traceback.
    first
        When that was [s since 1970].
    """

    where: str
    text: str
    first: float
    count: int


class ComponentStatus(Struct, frozen=True, kw_only=True):
    """A component as its container sees it.

    Parameters
    ----------
    error
        The last traceback, or empty.
    error_counts
        The errors by line and type, in the order in which they first came.
    handler, handler_seconds
        The timer or port whose code its thread runs now, and for how long already [s].
    cpu
        CPU time of its own code, on any thread [s].
    start
        How long it took to import, make and configure it [s].
    snapshot
        Size of its snapshot, if that was taken [bytes].
    requires, subscribes
        Its ports over which it calls others, and those to which messages come.
    """

    name: str
    epoch: int = 0
    state: State
    error: str = ""
    errors: int = 0
    error_counts: tuple[ErrorCount, ...] = ()
    handler: str = ""
    handler_seconds: float = 0.0
    cpu: float = 0.0
    start: float = 0.0
    snapshot: int = 0
    has_state: bool = False
    requires: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    timers: tuple[TimerStatus, ...] = ()
    measures: Mapping[str, Summary] = {}


class ContainerStatus(Struct, frozen=True, kw_only=True, tag=True):
    """A container as it sees itself.

    Parameters
    ----------
    cpu
        Its process's CPU time so far [s].
    trouble
        Why it accepts no connection now, and what to do; empty: it does.
    """

    name: str
    pid: int
    cpu: float = 0.0
    trouble: str = ""
    components: tuple[ComponentStatus, ...] = ()
    connectors: tuple[ConnectorStatus, ...] = ()


class ContainerFailure(Struct, frozen=True, tag=True):
    """The last words of a container that cannot go on."""

    reason: str


class ToContainer(Struct, frozen=True):
    """What an agent tells a container."""

    what: ContainerSpec | MigrationSteps | Clocks


class FromContainer(Struct, frozen=True):
    """What a container tells its agent."""

    what: ContainerStatus | ContainerFailure | StepsDone | StepsFailed


class Fault(Struct, frozen=True, kw_only=True):
    """Something that went wrong on a computer: a container that ended, say.

    Parameters
    ----------
    message
        What happened, what was lost, and what to do.
    number
        Counts the faults of one agent, from 1.
    at
        When [s since the epoch], by that computer's clock.
    restarts
        How often the container was started again before.
    is_over
        Whether it says that the fault before is over.
    """

    container: str
    message: str
    number: int = 0
    at: float = 0.0
    restarts: int = 0
    is_over: bool = False


class ContainerHealth(Struct, frozen=True, kw_only=True):
    """A container as its agent sees it; kept for as long as the agent lives.

    Parameters
    ----------
    state
        ``starting`` until it first reports; ``restarting`` while it waits to be
        started again.
    since
        When that state began [s since the epoch].
    reason
        Why it does not respond; else empty.
    restarts
        How often it was started again since the agent started.
    restarts_lately
        How often in the last minute.
    last_fault
        What went wrong last.
    cpu, memory
        CPU use [cores] and memory use [bytes] of its processes.
    """

    name: str
    state: ContainerState
    since: float
    reason: str = ""
    restarts: int = 0
    restarts_lately: int = 0
    last_fault: Fault | None = None
    cpu: float = 0.0
    memory: int = 0


class AgentStatus(Struct, frozen=True, kw_only=True):
    """A computer as its agent sees it.

    Parameters
    ----------
    manager, token
        The manager that it obeys, or obeyed last, with that one's fencing token.
    cpu
        CPU time of the agent and all its containers, ended ones too [s].
    uptime
        Time since the agent started [s].
    load, memory
        CPU use [cores] and memory use [bytes] of the agent and its containers.
    faults
        The latest faults, oldest first.
    health
        The containers of this deployment, and those that had faults before.
    clocks
        What is known of other computers' clocks, by name.
    gateway
        IP address and TCP port of its gateway.
    trouble
        Why that accepts no connection now, and what to do; empty: it does.
    """

    protocol: int = PROTOCOL
    computer: str
    generation: int
    token: int = 0
    manager: ManagerId | None = None
    uptime: float
    cpu: float
    load: float = 0.0
    memory: int = 0
    gateway: str = ""
    trouble: str = ""
    containers: tuple[ContainerStatus, ...] = ()
    faults: tuple[Fault, ...] = ()
    health: tuple[ContainerHealth, ...] = ()
    clocks: Mapping[str, ClockStatus] = {}
