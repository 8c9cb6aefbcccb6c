"""What those who only look at a robot are told, by whatever keeps it running."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from poise.errors import PoiseError
from poise.manage.agent_connections.output import read_log
from poise.manage.agent_connections.taps import read_tap
from poise.manage.control_socket.records import (
    Command,
    JournalCommand,
    JournalEntries,
    LogCommand,
    Refusal,
    Result,
    RobotStatus,
    StatusCommand,
    TapCommand,
)
from poise.manage.deploy.running_components import Run
from poise.manage.observe.chains import chain_reports
from poise.manage.observe.estimates import Estimates
from poise.manage.tasks.report import TaskReport
from poise.model.robot import Computer


def look(
    run: Run, status: Callable[[], RobotStatus], command: Command
) -> Result | Refusal | None:
    """Return the answer to a command that changes nothing; None: it is another one.

    It waits for no move, and may be called from any thread.
    """
    try:
        match command:
            case StatusCommand():
                return status()
            case JournalCommand(after=after, most=most):
                return JournalEntries(tuple(run.journal.entries(after, most)))
            case LogCommand():
                return read_log(run.agents, command)
            case TapCommand():
                return read_tap(run.agents, command)
    except PoiseError as error:
        return Refusal.from_error(error)
    return None


def status_of(
    run: Run, tasks: Sequence[TaskReport], estimates: Estimates
) -> RobotStatus:
    """Return the last known state, but for deviations and faults; from any thread."""
    statuses = run.agents.statuses()
    return RobotStatus(
        robot=run.robot.name,
        task=" and ".join(each.name for each in tasks if each.state == "going"),
        manager=run.agents.manager,
        placement=run.placement(),
        computers=statuses,
        out_of_reach=run.agents.out_of_reach(),
        demand_estimates=tuple(estimates.demand_estimates()),
        chains=chain_reports(run.robot, statuses),
        capacities={c.name: _capacity(c) for c in run.robot.computers},
        recent=run.journal.recent(),
        tasks=tuple(tasks),
        loads=estimates.loads.loads(),
        traffic=estimates.traffic(),
    )


def _capacity(computer: Computer) -> dict[str, float]:
    """Return what a computer has; an emulated slow one has a part of a core."""
    share = 1.0 if computer.address else computer.speed
    return {**computer.capacity, "cpu": computer.capacity.get("cpu", 0.0) * share}
