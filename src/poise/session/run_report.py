"""What a run showed, for people and machines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from msgspec import Struct
from msgspec.structs import asdict
from rich.console import RenderableType

from poise.errors import RunError
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import JournalEntry
from poise.manage.observe.chains import ChainReport
from poise.manage.observe.deviations import LocatedFault, faults_after
from poise.manage.tasks.task_reports import TaskReport
from poise.session.last_seen import LastSeen
from poise.session.launch.start import Started
from poise.session.placing.placement import Placement
from poise.session.render.picture import Hosted, picture
from poise.session.render.printable import Printable
from poise.session.render.report_page import page
from poise.session.render.run_tables import report_parts
from poise.session.run_records import (
    ComponentError,
    ComponentReport,
    HungHandler,
    Moment,
    SilentPort,
    component_errors,
    component_reports,
    cpu_shares,
    hung_handlers,
    refused_messages,
    silent_ports,
)
from poise.wire.records.heartbeat_records import ClockStatus
from poise.wire.records.status_records import ConnectorStatus, Summary

if TYPE_CHECKING:
    import pandas as pd

Table = Literal["components", "timers", "connectors", "chains"]


class RunReport(Printable, Struct, frozen=True, kw_only=True):
    """One run of a task. It prints itself as tables, in a terminal and in a notebook.

    Parameters
    ----------
    method
        What decided the placement, such as ``auto`` or ``static``.
    placement
        Component -> computer.
    decision_seconds
        How long the placement took to decide [s].
    seconds
        How long everything was active [s].
    cpu_share
        Computer -> CPU that its agent and containers used, as a share of what it has.
    began
        When everything was active [s since 1970].
    history
        How it was every second.
    journal
        What the manager saw and decided.
    chains
        How old the data of the robot's chains was when it was used.
    tasks
        How the tasks went, the first one that which was asked for.
    suspended
        Architectures that did not run, because not all fits.
    errors
        All that the components' code raised, by line and type.
    hung
        Handlers that had not ended when the run was over.
    refused
        Connector -> messages that its target refused.
    lost
        Connector -> messages that were sent and not processed in the end; of a
        container that ended, what it did after its last status counts as not done.
    silent
        Subscribed ports that got no message, and why.
    faults
        Containers that ended though they should have run.
    interrupted
        Whether the run was ended early, as by Ctrl-C.
    invalid
        Why the figures say nothing about the robot; empty when they do.
    clocks
        Computer -> other computer -> how far the other's clock was ahead at the end.
    without
        What the emulation did without.
    unrecorded
        What of the recording could not be written, and why; empty: all was.
    simulation
        What the simulated world said last.
    """

    robot: str
    task: str
    method: str
    placement: Mapping[str, str]
    decision_seconds: float
    seconds: float
    cpu_share: Mapping[str, float]
    components: tuple[ComponentReport, ...]
    connectors: tuple[ConnectorStatus, ...]
    began: float = 0.0
    history: tuple[Moment, ...] = ()
    journal: tuple[JournalEntry, ...] = ()
    chains: tuple[ChainReport, ...] = ()
    tasks: tuple[TaskReport, ...] = ()
    suspended: tuple[str, ...] = ()
    errors: tuple[ComponentError, ...] = ()
    hung: tuple[HungHandler, ...] = ()
    refused: Mapping[str, int] = {}
    lost: Mapping[str, int] = {}
    silent: tuple[SilentPort, ...] = ()
    faults: tuple[LocatedFault, ...] = ()
    interrupted: bool = False
    clocks: Mapping[str, Mapping[str, ClockStatus]] = {}
    invalid: str = ""
    without: tuple[str, ...] = ()
    unrecorded: str = ""
    simulation: Mapping[str, Any] = {}

    def component(self, name: str) -> ComponentReport:
        """Return the report of one component; KeyError when it did not run."""
        return {component.name: component for component in self.components}[name]

    @property
    def failed(self) -> bool:
        """Whether code raised or hung, a message was refused, or not all ran."""
        return bool(
            self.errors
            or self.hung
            or self.refused
            or self.faults
            or self.suspended
            or any(each.state == "failed" for each in self.tasks)
        )

    def rows(self, of: Table = "components") -> list[dict[str, Any]]:
        """Return components, their timers, connectors' ends or chains as flat values.

        Statistics have the name of what they are of, as in ``duration_p99``.
        """
        if of != "timers":
            return [_flat(each) for each in getattr(self, of)]
        return [
            {"component": component.name, "timer": timer.name, **_flat(timer, "name")}
            for component in self.components
            for timer in component.timers
        ]

    def to_pandas(self, of: Table = "components") -> pd.DataFrame:
        """Return `rows` as a data frame; pandas must be installed."""
        import pandas as pd

        return pd.DataFrame(self.rows(of))

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(report_parts(self))

    def picture(self) -> str:
        """Return where the components ran, as HTML."""
        hosted = [Hosted(c.name, c.computer, c.cpu) for c in self.components]
        return picture(self.cpu_share, hosted)

    def page(self) -> str:
        """Return an HTML page that needs no other file, and no network."""
        return page(self, self.picture(), self.html())


def _flat(record: Struct, *without: str) -> dict[str, Any]:
    """Return a record's plain values, and its summaries' ones under joined names."""
    found: dict[str, Any] = {}
    for name, value in asdict(record).items():
        if isinstance(value, Summary):
            found |= {
                f"{name}_{part}": number for part, number in asdict(value).items()
            }
        elif name not in without and not isinstance(value, tuple | Mapping):
            found[name] = value
    return found


class MeasuredRun(Struct, frozen=True, kw_only=True):
    """What was seen from when all had begun (`began`) until all was to end, [s]."""

    begin: Statuses
    end: Statuses
    began: float
    seconds: float
    history: tuple[Moment, ...]
    last_seen: LastSeen
    chains: tuple[ChainReport, ...]
    invalid: str
    interrupted: bool


def located_faults(live: LiveRobot) -> tuple[LocatedFault, ...]:
    """Return what went wrong on its computers since the robot started."""
    return tuple(
        LocatedFault(computer=computer, **asdict(fault))
        for computer, fault in faults_after(live.faults_before, live.agents.statuses())
    )


def reported(
    up: Started,
    placed: Placement,
    tasks: tuple[TaskReport, ...],
    seen: MeasuredRun,
    journal: tuple[JournalEntry, ...],
) -> RunReport:
    """Return the report of a run whose components are inactive, and have yet to end."""
    final = seen.last_seen.merged(up.live.agents.statuses())
    robot = up.live.robot
    invalid, simulation = seen.invalid, {}
    try:
        simulation = dict(up.world.result()) if up.world else {}
    except RunError as error:
        invalid = "; ".join(filter(None, [invalid, str(error)]))
    return RunReport(
        robot=robot.name,
        task=tasks[0].name,
        tasks=tasks,
        method=placed.method,
        placement=placed.where,
        decision_seconds=placed.result.seconds,
        seconds=seen.seconds,
        cpu_share=cpu_shares(robot, seen.begin, seen.end, up.computers.faster),
        components=component_reports(seen.begin, final, seen.seconds),
        connectors=tuple(seen.last_seen.connectors()),
        began=seen.began,
        history=seen.history,
        journal=journal,
        chains=seen.chains,
        suspended=placed.result.suspended,
        errors=component_errors(seen.last_seen.stays()),
        hung=hung_handlers(final),
        refused=refused_messages(final),
        lost=seen.last_seen.unprocessed(up.live.agents.statuses()),
        silent=silent_ports(robot, final),
        clocks={name: each.clocks for name, each in sorted(seen.end.items())},
        interrupted=seen.interrupted,
        invalid=invalid,
        without=up.computers.without,
        simulation=simulation,
    )
