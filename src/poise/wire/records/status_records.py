"""What agents and containers report: states, counters and faults."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Literal

from msgspec import Struct

from poise.wire.records.deployment_records import ConnectorKind, ContainerSpec
from poise.wire.records.heartbeat_records import Clocks, ClockStatus, LinkQuality
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsFailed
from poise.wire.records.request_records import (
    ManagerId,
    PortAnswer,
    PortRequest,
    Tap,
    TapReading,
)

State = Literal[
    "unconfigured", "inactive", "active", "finalized", "failed", "unresponsive"
]
"""Where a component is. `unresponsive`: its agent says so, because its container does
not respond."""

ContainerState = Literal["starting", "running", "unresponsive", "restarting", "stopped"]

Side = Literal["source", "target", "both"]


class Summary(Struct, frozen=True):
    """Many values of one measurement, in its own unit."""

    count: int = 0
    mean: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    maximum: float = 0.0


class TimerStatus(Struct, frozen=True, kw_only=True):
    """How a timer kept its rate."""

    name: str
    period: float
    deadline: float | None
    releases: int  # How often it was due while the component was active there
    missed: int  # How many of these ended after their deadline, or never began
    # From release to start, and from start to end [s]
    lateness: Summary
    duration: Summary


class ChainStatus(Struct, frozen=True, kw_only=True):
    """How old the data of a chain was when one of its components used it."""

    name: str
    # How old it may be, at the last component of the chain [s]; None elsewhere
    deadline: float | None = None
    missed: int = 0  # How often it was older
    age: Summary = Summary()  # At each use [s]


class ConnectorStatus(Struct, frozen=True, kw_only=True):
    """What one end of a connector counted, since its component began to run there."""

    name: str
    # What both ends call it, by their epochs: another one after every move
    key: str = ""
    kind: ConnectorKind
    # Where calls and messages begin (``source``), where they end (``target``), or
    # ``both`` in one container: then all is counted once
    end: Side
    ready: bool
    refusal: str = ""  # At the source: why the other computer is not reached, if known
    calls: int = 0
    messages: int = 0
    # What left this end over a wire, and what came to it [bytes]: at the source
    # requests and messages go out and answers come in, at the target the other way
    # round. None within a container
    bytes_out: int = 0
    bytes_in: int = 0
    errors: int = 0  # Calls that failed, and what came and was refused
    # Of these, messages and one-way calls that are not of the port's type. Who called
    # otherwise has the error, and may expect it
    refused: int = 0
    # Messages that this end gave up: they could not go out, found no room, or made room
    # for newer ones
    drops: int = 0
    # Of calls [s]: at the source there and back, at the target until the answer
    delay: Summary = Summary()
    # Of messages [s]: at the source until they went out, elsewhere from their arrival
    # until the component took them
    wait: Summary = Summary()
    # Of calls, both ways, and of messages, over a wire [bytes]
    size: Summary = Summary()
    # From the other end to this one [s]: at the target how long calls and messages were
    # under way, at the source answers. Over a wire only
    latency: Summary = Summary()
    # How far that is off at most, in the mean [s]: nobody knows better how far other
    # computers' clocks are ahead. 0 on one computer
    latency_error: float = 0.0

    @property
    def count(self) -> int:
        """Calls and messages together."""
        return self.calls + self.messages


class ErrorCount(Struct, frozen=True, kw_only=True):
    """Errors of one type that one line of a component's code raised."""

    where: str  # The hook, timer or port whose code raised them
    text: str  # The first one's traceback
    first: float  # When that was [s since 1970]
    count: int


class ActionEnd(Struct, frozen=True, kw_only=True):
    """What a component said at a port that ends an action."""

    port: str
    count: int  # One more each time; another start of the component begins anywhere
    done: bool  # What it said last


class TaskRequest(Struct, frozen=True, kw_only=True):
    """What a component wants done with a task; numbers are as in `ActionEnd`."""

    number: int
    verb: Literal["start", "pause", "resume", "cancel"]
    task: str


class ComponentStatus(Struct, frozen=True, kw_only=True):
    """A component as its container sees it."""

    name: str
    epoch: int = 0
    state: State
    error: str = ""  # The last traceback, or empty
    errors: int = 0
    # The errors by line and type, in the order in which they first came
    error_counts: tuple[ErrorCount, ...] = ()
    # The timer, port or hook whose code its thread runs now, and for how long [s]
    handler: str = ""
    handler_seconds: float = 0.0
    hung: float = 0.0  # For how long a handler has run, or a due timer could not [s]
    cpu: float = 0.0  # CPU time of its own code, on any thread [s]
    start: float = 0.0  # How long it took to import, make and configure it [s]
    snapshot: int = 0  # Size of its snapshot, if that was taken [bytes]
    has_state: bool = False
    copies_ahead: bool = False  # Whether its state is copied before a pause, too
    # Its ports over which it calls others, and those to which messages come
    requires: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    # Of the latter, those that keep only the newest messages, and how many
    keeps: Mapping[str, int] = {}
    timers: tuple[TimerStatus, ...] = ()
    # Timer, port at which messages come, or connector over which another container
    # calls -> the CPU time of its runs [s]; measured only for a profile
    work: Mapping[str, Summary] = {}
    # The same -> for how long runs waited beyond their calls, those that did [s]
    waits: Mapping[str, Summary] = {}
    # Those that it is part of, and not the beginning
    chains: tuple[ChainStatus, ...] = ()
    ends: tuple[ActionEnd, ...] = ()  # What it said of its actions
    task_requests: tuple[TaskRequest, ...] = ()  # The last ones
    measures: Mapping[str, Summary] = {}

    @property
    def key(self) -> tuple[str, int]:
        """Name and epoch, which tell it from all other incarnations."""
        return self.name, self.epoch

    @property
    def missed(self) -> int:
        """How many deadlines its timers have missed."""
        return sum(timer.missed for timer in self.timers)


class ContainerStatus(Struct, frozen=True, kw_only=True, tag=True, dict=True):
    """A container as it sees itself."""

    name: str
    pid: int
    at: float = 0.0  # When this was so [s, on its computer's clock]
    cpu: float = 0.0  # Its process's CPU time so far [s]
    # Why it accepts no connection now, and what to do; empty: it does
    trouble: str = ""
    components: tuple[ComponentStatus, ...] = ()
    connectors: tuple[ConnectorStatus, ...] = ()

    @cached_property
    def states(self) -> tuple[object, ...]:
        """What is worth a word at once when it changes; counters are not."""
        components = [
            (
                component.name,
                component.epoch,
                component.state,
                component.errors,
                component.task_requests,
            )
            for component in self.components
        ]
        connectors = [
            (connector.name, connector.ready) for connector in self.connectors
        ]
        return self.name, components, connectors

    @cached_property
    def missed(self) -> int:
        """How many deadlines its timers have missed."""
        return sum(component.missed for component in self.components)


class Fault(Struct, frozen=True, kw_only=True):
    """Something that went wrong on a computer: a container that ended, say."""

    container: str
    message: str  # What happened, what was lost, and what to do
    number: int = 0  # Counts the faults of one agent, from 1
    at: float = 0.0  # When [s since the epoch], by that computer's clock; for people
    uptime: float = 0.0  # For how long its agent had run then [s]
    restarts: int = 0  # How often the container was started again before
    is_over: bool = False  # Whether it says that the fault before is over


class ContainerHealth(Struct, frozen=True, kw_only=True):
    """A container as its agent sees it; kept for as long as the agent lives."""

    name: str
    # ``starting`` until it first reports; ``restarting`` while it waits to be started
    # again
    state: ContainerState
    since: float  # When that state began [s since the epoch]
    reason: str = ""  # Why it does not respond or cannot be started; else empty
    restarts: int = 0  # How often it was started again since the agent started
    restarts_lately: int = 0  # How often in the last minute
    last_fault: Fault | None = None  # What went wrong last
    # CPU use [cores] and memory use [bytes] of its processes
    cpu: float = 0.0
    memory: int = 0
    # By how much its memory grows steadily [bytes/s]; 0: it does not
    growth: float = 0.0
    # While it grows: the limit of its computer's memory [bytes], and when that is
    # reached [s from now]; else 0
    limit: float = 0.0
    full_in: float = 0.0


class AgentStatus(Struct, frozen=True, kw_only=True, dict=True):
    """A computer as its agent sees it."""

    version: str = ""  # Of Poise
    computer: str
    pid: int = 0  # The agent's process
    # Of this start: another boot may give the same number; empty before protocol 14
    key: str = ""
    # The containers of an earlier agent, which was killed, that it took over; None: not
    # known (before protocol 14)
    took_over: tuple[str, ...] | None = None
    generation: int
    # Whether the robot is at work for all that it knows, though not here
    is_at_work: bool = False
    has_standbys: bool = False  # Whether another manager leads when that one is gone
    # The manager that it obeys, or obeyed last, with that one's fencing token
    token: int = 0
    manager: ManagerId | None = None
    uptime: float  # Time since the agent started [s]
    cpu: float  # CPU time of the agent and all its containers, ended ones too [s]
    # CPU use [cores] and memory use [bytes] of the agent and its containers
    load: float = 0.0
    memory: int = 0
    gateway: str = ""  # IP address and TCP port of its gateway
    # What the agent cannot do now, and what to do; empty: it can do all
    trouble: str = ""
    # What is to be known though nothing is wrong, as of its keys
    notice: str = ""
    # Whether the next agent starts soon here, and adopts the containers
    is_leaving: bool = False
    # Errors of its own code within the last minute: the part that is tried again later,
    # and the traceback. The rest goes on
    errors: tuple[ErrorCount, ...] = ()
    # Its machine, Python and C library, as in ``aarch64 3.11 2.36``
    platform: str = ""
    # What it has: cores that it may use, and memory [bytes]; 0: not known
    cores: float = 0.0
    computer_memory: int = 0
    code: tuple[str, ...] = ()  # The versions of code that are there, the last first
    # What gives containers their CPU weights: ``cgroup v2``, ``cgroup v1`` or ``nice``;
    # empty: all have the same
    cpu_weights: str = ""
    containers: tuple[ContainerStatus, ...] = ()
    faults: tuple[Fault, ...] = ()  # The latest faults, oldest first
    # The containers of this deployment, and those that had faults before
    health: tuple[ContainerHealth, ...] = ()
    # What is known of other computers' clocks, by name
    clocks: Mapping[str, ClockStatus] = {}
    # Since when its leased components are inactive, because its lease has ended [s
    # since 1970]; 0: they are not
    cut_off: float = 0.0
    # Since when it knows of no manager that is there: that one went, or the agent
    # started [s since 1970]; 0: one is there
    unmanaged: float = 0.0
    # How the ways to other computers are, by name
    links: Mapping[str, LinkQuality] = {}

    @property
    def start(self) -> tuple[int, str]:
        """What tells this start of the agent from all others."""
        return self.pid, self.key

    @cached_property
    def components(self) -> tuple[ComponentStatus, ...]:
        """The components in all containers."""
        return tuple(c for container in self.containers for c in container.components)

    @cached_property
    def states(self) -> tuple[object, ...]:
        """What is worth a word at once when it changes; counters are not."""
        return (
            self.generation,
            self.token,
            self.faults[-1].number if self.faults else 0,
            bool(self.cut_off),
            self.code,
            [(error.where, error.count) for error in self.errors],
            [(health.name, health.state) for health in self.health],
            [container.states for container in self.containers],
        )

    @cached_property
    def missed(self) -> int:
        """How many deadlines the timers of its components have missed."""
        return sum(container.missed for container in self.containers)


ENDING_LIMIT = 10.0
"""`deactivate` and `cleanup` of a process's components end within this time [s], or it
is ended."""
SAMPLE_EVERY = 0.2
"""How often agents tell what they count, unless asked for another rate [s]."""


class ComponentSample(Struct, frozen=True, array_like=True):
    """A component's counters; `epoch` tells incarnations of one component apart."""

    name: str
    epoch: int
    cpu: float  # CPU time [s]
    # Time in which its thread could run and did not [s]; 0 for components with jobs,
    # which tell better whether it keeps up
    wait: float
    # Releases of timers and messages that came, and that were ended
    asked: int
    done: int


class ConnectorSample(Struct, frozen=True, array_like=True):
    """The counters of one end of a connector."""

    name: str
    calls: int
    messages: int
    # What left this end over a wire, and what came to it
    bytes_out: int
    bytes_in: int
    errors: int
    drops: int
    arrivals: int = 0  # How many came of whom it is known how long they were under way
    # How long those were so, in all, and how far that is off at most [s]
    latency: float = 0.0
    latency_error: float = 0.0


class ContainerSample(Struct, frozen=True, array_like=True):
    """A container's counters."""

    name: str
    pid: int
    at: float  # When they were read [s], on its computer's clock
    cpu: float  # CPU time of the process [s]
    memory: int  # Its proportional set size [bytes]; read less often than the rest
    components: tuple[ComponentSample, ...]
    connectors: tuple[ConnectorSample, ...]


class AgentSample(Struct, frozen=True, array_like=True):
    """A computer's counters."""

    computer: str
    at: float
    cpu: float  # CPU time of the agent itself [s]
    containers: tuple[ContainerSample, ...]
    # CPU time of all programs of the computer, the robot's or not [s]; None: nobody
    # counts it
    busy: float | None = None


class ContainerFailure(Struct, frozen=True, tag=True):
    """What a container says when it cannot go on, or a component ended badly."""

    reason: str
    goes_on: bool = False


ContainerRequest = MigrationSteps | Tap | PortRequest
"""What a manager asks of a container by way of its agent."""
ContainerAnswer = StepsDone | StepsFailed | TapReading | PortAnswer

ToContainer = ContainerSpec | Clocks | ContainerRequest
"""What an agent sends a container."""
FromContainer = ContainerStatus | ContainerFailure | ContainerAnswer
"""What a container sends its agent."""
