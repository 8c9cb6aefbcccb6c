"""Answers to commands that change no placement: status, journal, log, taps, ports."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError, RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.control_socket.commands import (
    STALE,
    Command,
    JournalCommand,
    JournalEntries,
    LogCommand,
    LogReading,
    PortCommand,
    Refusal,
    Result,
    RobotStatus,
    StatusCommand,
    TapCommand,
)
from poise.manage.control_socket.port_requests import ask_port
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.observe.chains import chain_reports
from poise.manage.observe.deviations import Deviation
from poise.manage.observe.estimates import Estimates
from poise.manage.tasks.concurrent_tasks import TaskReport
from poise.model.robot import Computer
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import (
    OutputLines,
    ReadOutput,
    Refused,
    Tap,
    TapReading,
)

_ANSWER_LIMIT = 1.0
"""An agent tells what was written, or went out, within this time [s]."""
_BITS = 62


def answer(
    run: RunningComponents, status: Callable[[], RobotStatus], command: Command
) -> Result | Refusal | None:
    """Return the answer to a command that changes no placement; None: another one.

    It waits for no move, and may be called from any thread.
    """
    done: Result | None = None
    try:
        match command:
            case StatusCommand():
                done = status()
            case JournalCommand(after=after, most=most):
                done = JournalEntries(tuple(run.journal.entries(after, most)))
            case LogCommand():
                done = _read_log(run.agents, command)
            case TapCommand():
                done = _read_tap(run.agents, command)
            case PortCommand():
                done = ask_port(run, command)
    except PoiseError as error:
        return Refusal.from_error(error)
    return done


def status_of(
    run: RunningComponents, tasks: Sequence[TaskReport], estimates: Estimates
) -> RobotStatus:
    """Return the last known state, but for deviations and faults; from any thread."""
    statuses, ages = run.agents.statuses(), run.agents.ages()
    out_of_reach = run.agents.out_of_reach()
    return RobotStatus(
        robot=run.robot.name,
        task=" and ".join(task.name for task in tasks if task.state == "going"),
        manager=run.agents.manager,
        placement=run.placement(),
        computers=statuses,
        ages=ages,
        out_of_reach=out_of_reach,
        deviations=tuple(_silent(ages, out_of_reach, wall_time())),
        demand_estimates=tuple(estimates.demand_estimates()),
        chains=chain_reports(run.robot, statuses),
        capacities={c.name: _capacity(c) for c in run.robot.computers},
        parameters=run.desired.parameters,
        memory_demands=run.robot.demands("memory"),
        recent=run.journal.recent(),
        tasks=tuple(tasks),
        robot_tasks=tuple(task.name for task in run.robot.tasks),
        loads=estimates.loads.loads(),
        traffic=estimates.traffic(),
    )


def _silent(
    ages: Mapping[str, float], out_of_reach: Collection[str], now: float
) -> Iterator[Deviation]:
    for name, age in sorted(ages.items()):
        if age > STALE and name not in out_of_reach:
            what = (
                f"the agent of '{name}' is connected, but has stopped reporting: what "
            )
            what += "runs there is unknown; check its process and the load there"
            yield Deviation(what=what, computer=name, since=now - age)


def _capacity(computer: Computer) -> dict[str, float]:
    """Return what a computer has; an emulated slow one has a part of a core."""
    share = 1.0 if computer.address else computer.speed
    return {**computer.capacity, "cpu": computer.capacity.get("cpu", 0.0) * share}


def _read_log(agents: Agents, command: LogCommand) -> LogReading:
    """Return what was written after the moments of a command; from any thread."""
    asked = {
        computer: ReadOutput(
            component=command.component,
            after=command.after.get(computer, 0),
            most=command.most,
        )
        for computer in agents.statuses()
    }
    answers = agents.ask_all(asked, _ANSWER_LIMIT)
    after, lines, omitted = dict(command.after), [], 0
    for computer, answer in answers.items():
        if isinstance(answer, OutputLines):
            lines += [replace(line, computer=computer) for line in answer.lines]
            omitted += answer.omitted
            if answer.lines:
                after[computer] = answer.lines[-1].at
    lines.sort(key=lambda line: line.at)
    last = lines[-command.most :]
    silent = [c for c, answer in answers.items() if not isinstance(answer, OutputLines)]
    omitted += len(lines) - len(last)
    return LogReading(tuple(last), after, omitted, tuple(sorted(silent)))


def _read_tap(agents: Agents, command: TapCommand) -> TapReading:
    """Return what has gone out since the viewer asked last; from any thread."""
    connector, computer, container = begin_of(agents.statuses(), command.connector)
    asked = Tap(
        number=secrets.randbits(_BITS),
        container=container,
        connector=connector,
        viewer=command.viewer,
        rate=command.rate,
        items=command.items,
        is_whole=command.is_whole,
        limit=_ANSWER_LIMIT,
    )
    reply = agents.ask(computer, asked, _ANSWER_LIMIT)
    if isinstance(reply, TapReading):
        return reply
    why = f"no answer within {_ANSWER_LIMIT:g} s"
    if isinstance(reply, Refused | StepsFailed):
        why = reply.reason
    raise RunError(f"connector '{connector}' on '{computer}': {why}")


def begin_of(statuses: Statuses, asked: str) -> tuple[str, str, str]:
    """Return a connector's name, and the computer and container where it begins."""
    found = dict(_begins(statuses))
    sources = [name for name in found if name.startswith(f"{asked}-")]
    targets = [name for name in found if name.endswith(f"-{asked}")]
    names = [asked] if asked in found else sources or targets
    if not names:
        listed = "; ".join(sorted(found)) or "none"
        raise UsageError(f"no connector '{asked}' (there are: {listed})")
    if names == targets and len(names) > 1:
        raise UsageError(
            f"several connectors end at '{asked}': {'; '.join(sorted(names))}"
        )
    return (names[0], *found[names[0]])


def _begins(statuses: Statuses) -> Iterator[tuple[str, tuple[str, str]]]:
    for computer, status in sorted(statuses.items()):
        for container in status.containers:
            for end in container.connectors:
                if end.end != "target":
                    yield end.name, (computer, container.name)
