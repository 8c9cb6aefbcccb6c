"""What a control client sends to the manager of a running robot, and its answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from msgspec import Struct

from poise.errors import PoiseError, RobotError, RunError, UsageError
from poise.estimate.profiles import ConnectorProfile
from poise.manage.journal import JournalEntry
from poise.manage.migration.migration_report import (
    MigrationReport,
    Proposal,
    TransitionReport,
    WhatIf,
)
from poise.manage.observe.chains import ChainReport
from poise.manage.observe.deviations import Deviation
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.manage.tasks.task_reports import PrefetchReport, TaskReport
from poise.wire.codec import Packed
from poise.wire.records.request_records import (
    SHOWN_ITEMS,
    ManagerId,
    OutputLine,
    PortAnswer,
    TapReading,
)
from poise.wire.records.status_records import AgentStatus


class StatusCommand(Struct, frozen=True, tag=True):
    """Return the last known state; answered at once, even during a move."""


class StopCommand(Struct, frozen=True, tag=True):
    """Stop the robot; a move under way is rolled back."""


class MoveCommand(Struct, frozen=True, tag=True):
    """Move a component; `force`: also where it does not fit; `dry`: say what if."""

    component: str
    computer: str
    force: bool = False
    dry: bool = False


class JournalCommand(Struct, frozen=True, tag=True):
    """Return the last `most` entries of the journal that have numbers above `after`."""

    after: int = 0
    most: int = 500


class ReplaceCommand(Struct, frozen=True, tag=True):
    """Swap a component's implementation, or put an architecture in another's place.

    `by` is ``package.module:Class``, with ``@VERSION`` of deployed code, or the other
    architecture; `adapt` maps states; `fresh`: what comes begins without state;
    `watch`: for so long the component before comes back when the new one fails [s].
    """

    what: str
    by: str
    adapt: str = ""
    fresh: bool = False
    watch: float = 0.0


class RebalanceCommand(Struct, frozen=True, tag=True):
    """Find a better placement, and go there unless `dry`."""

    move: float  # what F grows by for each component that moves
    dry: bool = False


class TapCommand(Struct, frozen=True, tag=True):
    """Tell what has gone out over a connector since `viewer` asked last; see `Tap`."""

    connector: str  # its name, or ``component.port`` of an end
    viewer: str
    rate: float = 0.0
    items: int = SHOWN_ITEMS
    is_whole: bool = False
    latest: tuple[int, int] | None = None


class PortCommand(Struct, frozen=True, tag=True, kw_only=True):
    """Give a port a message, publish one there, or call it; see `PortRequest`."""

    component: str
    port: str
    method: str = ""
    value: Packed
    limit: float = 1.0  # done within this time, wherever the component is [s]


class ParametersCommand(Struct, frozen=True, tag=True, kw_only=True):
    """Set parameters of a component that runs, for as long as its robot is up."""

    component: str
    changes: Packed
    limit: float = 1.0


class LogCommand(Struct, frozen=True, tag=True):
    """Tell what components wrote; see `ReadOutput`. `after`: computer -> moment."""

    component: str = ""
    after: Mapping[str, int] = {}
    most: int = 1_000


class TaskCommand(Struct, frozen=True, tag=True):
    """Start, pause, resume or cancel a task; `priority`: None is the robot file's."""

    verb: Literal["start", "pause", "resume", "cancel"]
    task: str
    priority: int | None = None


Command = (
    StatusCommand
    | JournalCommand
    | StopCommand
    | MoveCommand
    | ReplaceCommand
    | RebalanceCommand
    | TapCommand
    | PortCommand
    | ParametersCommand
    | LogCommand
    | TaskCommand
)
RecordCommand = StatusCommand | JournalCommand
"""Asks for what the manager knows: answered without an agent, also while it stops."""
LookCommand = RecordCommand | TapCommand | LogCommand
"""Changes nothing."""


STALE = 5.0
"""What an agent reported longer ago [s] says nothing about now."""


class RobotStatus(Struct, frozen=True, tag=True, kw_only=True):
    """The last known state of a running robot."""

    robot: str
    task: str  # the names of the tasks that are at work
    manager: ManagerId
    placement: Mapping[str, str]  # component -> computer, as the manager wants it
    computers: Mapping[str, AgentStatus]  # computer -> what its agent reported last
    # computer -> how long ago its agent reported that [s]
    ages: Mapping[str, float] = {}
    # computer -> since when its agent has not been reached [s since 1970]
    out_of_reach: Mapping[str, float] = {}
    deviations: tuple[Deviation, ...] = ()
    under_way: tuple[str, ...] = ()
    faults: int = 0  # how many faults there were since the start; they may be over
    # components that lost their state when they were started elsewhere: the last time
    lost_states: tuple[Deviation, ...] = ()
    demand_estimates: tuple[DemandEstimate, ...] = ()
    chains: tuple[ChainReport, ...] = ()  # how old the data of the robot's chains was
    # computer -> what it has: ``cpu`` [its own cores], ``memory`` [bytes],
    capacities: Mapping[str, Mapping[str, float]] = {}
    # component -> the memory that it was placed by [bytes]
    memory_demands: Mapping[str, float] = {}
    recent: tuple[JournalEntry, ...] = ()
    tasks: tuple[TaskReport, ...] = ()
    # component -> its parameters that were set since the start
    parameters: Mapping[str, Mapping[str, Any]] = {}
    robot_tasks: tuple[str, ...] = ()  # those that can be started
    prefetch: PrefetchReport = PrefetchReport()  # what prefetch was good for
    loads: Mapping[str, Load] = {}
    hanging: tuple[str, ...] = ()  # the components that policy `hang` is about
    # the connectors that ROS 2 makes, between nodes: topics, services, actions
    by_ros2: tuple[str, ...] = ()
    traffic: Mapping[str, ConnectorProfile] = {}  # connector -> what goes over it now
    # whether agents said this, since no manager answers; the first deviation says why.
    # Then `manager` is the last one, `placement` where components are, and what only a
    # manager knows is empty: tasks, demands, capacities, decisions
    by_agents: bool = False
    notice: str = ""  # what is to be known of the manager, though nothing is wrong

    def not_known(self) -> set[str]:
        """Return the computers of which it is not known how they are now."""
        stale = {name for name, age in self.ages.items() if age > STALE}
        known = self.computers.keys() - stale - self.out_of_reach.keys()
        named = {*self.computers, *self.capacities, *self.placement.values()}
        return (named | self.out_of_reach.keys()) - known

    def background(self, computer: str) -> float | None:
        """Return what other programs use of a computer [its cores]; None: not known."""
        load = self.loads.get(computer)
        if load is None or not load.capacity:
            return None
        cores = self.capacities.get(computer, {}).get("cpu", 0.0)
        return load.background / load.capacity * cores


class StopReport(Struct, frozen=True, tag=True):
    """The robot has stopped; `remaining` says what still runs where, if anything."""

    remaining: tuple[str, ...] = ()


class JournalEntries(Struct, frozen=True, tag=True):
    """Entries of the journal, oldest first."""

    entries: tuple[JournalEntry, ...]


class Rebalanced(Struct, frozen=True, tag=True):
    """A proposal, and the outcome of going there; no report when nothing was done."""

    proposal: Proposal
    report: TransitionReport | None = None


class LogReading(Struct, frozen=True, tag=True):
    """What components wrote, oldest first."""

    lines: tuple[OutputLine, ...]
    after: Mapping[str, int]
    omitted: int = 0  # how many lines there were before, on the computers together
    silent: tuple[str, ...] = ()  # the computers that gave no answer


class TaskDone(Struct, frozen=True, tag=True):
    """What was asked of a task was done; how it is now."""

    report: TaskReport


Result = (
    RobotStatus
    | StopReport
    | MigrationReport
    | Rebalanced
    | TaskDone
    | TapReading
    | PortAnswer
    | LogReading
    | JournalEntries
    | WhatIf
)


class Refusal(Struct, frozen=True, tag=True):
    """The command was not carried out; `error` is the class of the client's error."""

    reason: str
    error: Literal["UsageError", "RobotError", "RunError"] = "UsageError"

    @classmethod
    def from_error(cls, error: PoiseError) -> Refusal:
        """Return the refusal for an error of the manager."""
        for name in ("UsageError", "RobotError"):
            if type(error).__name__ == name:
                return cls(str(error), name)
        return cls(str(error), "RunError")

    def to_error(self) -> PoiseError:
        """Return the client's error."""
        classes = {e.__name__: e for e in (UsageError, RobotError, RunError)}
        return classes[self.error](self.reason)


Response = Result | Refusal
"""What a client gets for its command."""
