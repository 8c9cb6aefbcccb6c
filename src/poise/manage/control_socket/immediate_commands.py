"""Answers to commands that change no placement: status, journal, log, taps, ports."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError, RunError, UsageError, did_you_mean, listed
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import Statuses, components_of
from poise.manage.control_socket.commands import (
    STALE,
    Command,
    JournalCommand,
    JournalEntries,
    LogCommand,
    LogReading,
    ParametersCommand,
    PortCommand,
    Refusal,
    Result,
    RobotStatus,
    StatusCommand,
    TapCommand,
)
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.observe.chains import chain_reports
from poise.manage.observe.deviations import Deviation
from poise.manage.observe.estimates import Estimates
from poise.manage.tasks.task_reports import TaskReport
from poise.units import format_bytes
from poise.wire.codec import pack, unpack
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import (
    MOST_PACKED,
    PARAMETERS,
    OutputLine,
    OutputLines,
    PortAnswer,
    PortRequest,
    ReadOutput,
    Refused,
    Tap,
    TapReading,
)

LONGEST = 50.0
"""Nobody waits longer for an answer [s]."""
_MARGIN = 0.5
"""An answer is here so long after it was due at the latest [s]."""
_LOOK_EVERY = 0.02
_ANSWER_LIMIT = 1.0
"""An agent tells what was written, or went out, within this time [s]."""
_BITS = 62
"""Of the numbers of requests."""


def ask_port(live: LiveRobot, command: PortCommand) -> PortAnswer:
    """Return what came of a command; from any thread.

    It waits, within its limit, for a component that moves, restarts or is lost, and
    asks a second time only where it was surely not begun.
    """
    _check(live, command)
    clock, name = live.clock, command.component
    until = clock.now() + command.limit
    while True:
        placed, why = _place(live, name)
        if placed is not None:
            answer = _ask(live, command, placed, until)
            if answer.outcome != "away":
                return answer
            why = answer.reason
        if live.is_over.is_set():
            raise RunError("the robot is being stopped")
        if clock.now() >= until:
            raise RunError(
                f"'{name}.{command.port}' was not reached within {command.limit:g} s: "
                f"{why}"
            )
        clock.sleep(_LOOK_EVERY)


def set_parameters(live: LiveRobot, command: ParametersCommand) -> PortAnswer:
    """Let a component take other parameters, or refuse; from any thread."""
    commands = {entry.name for entry in live.robot.components() if entry.command}
    if command.component in commands:
        raise UsageError(
            f"component '{command.component}' is a command line: it reads its "
            "parameters when it starts"
        )
    changes = unpack(command.changes, dict[str, Any])
    return ask_port(
        live,
        PortCommand(
            component=command.component,
            port=PARAMETERS,
            method="set",
            value=pack(((), changes)),
            limit=command.limit,
        ),
    )


def _check(live: LiveRobot, command: PortCommand) -> None:
    known = sorted(component.name for component in live.robot.components())
    if command.component not in known:
        guess = did_you_mean(command.component, known)
        raise UsageError(
            f"no component '{command.component}'{guess}; there are {listed(known)}"
        )
    if not 0 < command.limit <= LONGEST:
        raise UsageError(
            f"a limit of {command.limit:g} s: must be above 0 and at most {LONGEST:g} s"
        )
    if command.value.size > MOST_PACKED:
        raise UsageError(
            f"{format_bytes(command.value.size)} at once: at most "
            f"{format_bytes(MOST_PACKED)} go to a robot from outside"
        )


def _place(live: LiveRobot, name: str) -> tuple[Incarnation | None, str]:
    """Return the incarnation of a component that is active, or None and why not."""
    placed = live.placed.get(name)
    if placed is None:
        why = "no task at work needs it, or its architecture is suspended"
        return None, f"component '{name}' does not run: {why}"
    if placed.computer in live.agents.out_of_reach():
        return None, f"computer '{placed.computer}' is out of reach"
    statuses = live.agents.statuses()
    here = {c: s for c, s in statuses.items() if c == placed.computer}
    for component in components_of(here):
        if component.key == (name, placed.epoch):
            is_active = component.state == "active"
            return placed if is_active else None, f"it is {component.state}"
    return None, f"component '{name}' does not run on '{placed.computer}' yet"


def _ask(
    live: LiveRobot, command: PortCommand, placed: Incarnation, until: float
) -> PortAnswer:
    limit = max(0.0, until - live.clock.now())
    request = PortRequest(
        number=secrets.randbits(_BITS),
        container=live.layout.container_of(placed),
        component=command.component,
        port=command.port,
        method=command.method,
        value=command.value,
        limit=limit,
    )
    answer = live.agents.request(placed.computer, request, limit + _MARGIN)
    if isinstance(answer, PortAnswer):
        return answer
    what = "call" if command.method else "message"
    if live.clock.now() >= until:
        why = f"no answer within {command.limit:g} s; the {what} may have been taken"
        return PortAnswer(number=request.number, outcome="late", reason=why)
    why = f"computer '{placed.computer}' gave no answer"
    if isinstance(answer, Refused | StepsFailed):
        why = answer.reason
    raise RunError(
        f"'{command.component}.{command.port}': {why}; the {what} may have been taken"
    )


def answer(
    live: LiveRobot, status: Callable[[], RobotStatus], command: Command
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
                done = JournalEntries(tuple(live.journal.entries(after, most)))
            case LogCommand():
                done = _read_log(live.agents, command)
            case TapCommand():
                done = _read_tap(live, command)
            case PortCommand():
                done = ask_port(live, command)
    except PoiseError as error:
        return Refusal.from_error(error)
    return done


def status_of(
    live: LiveRobot, tasks: Sequence[TaskReport], estimates: Estimates
) -> RobotStatus:
    """Return the last known state; of deviations, those of agents that are silent."""
    statuses, ages = live.agents.statuses(), live.agents.ages()
    out_of_reach, placement = live.agents.out_of_reach(), live.placement()
    keys = live.agents.own_keys
    return RobotStatus(
        robot=live.robot.name,
        task=" and ".join(task.name for task in tasks if task.state == "going"),
        manager=live.agents.manager,
        placement=placement,
        computers=statuses,
        ages=ages,
        out_of_reach=out_of_reach,
        deviations=tuple(_silent(ages, out_of_reach, wall_time())),
        demand_estimates=tuple(
            each for each in estimates.demand_estimates() if each.component in placement
        ),
        chains=chain_reports(live.robot, statuses),
        capacities={  # an emulated slow computer has a part of a core
            c.name: {**c.capacity, "cpu": c.own_cores} for c in live.robot.computers
        },
        parameters=live.desired.parameters,
        memory_demands=live.robot.demands("memory"),
        recent=live.journal.recent(),
        tasks=tuple(tasks),
        robot_tasks=tuple(task.name for task in live.robot.tasks),
        loads=estimates.loads.loads(without=out_of_reach),
        by_ros2=_by_ros2(live),
        traffic=estimates.traffic(),
        notice="" if keys is None or keys.trouble else keys.latest().warning(),
    )


def _by_ros2(live: LiveRobot) -> tuple[str, ...]:
    placed = live.placement()
    return tuple(
        connector.name
        for connector in live.robot.all_connectors()
        if connector.topic and all(end.component in placed for end in connector.between)
    )


def _silent(
    ages: Mapping[str, float], out_of_reach: Collection[str], now: float
) -> Iterator[Deviation]:
    for name, age in sorted(ages.items()):
        if age > STALE and name not in out_of_reach:
            what = (
                f"the agent of '{name}' is connected, but has stopped reporting: its "
                "components are unknown; check its process and the load there"
            )
            yield Deviation(what=what, computer=name, since=now - age)


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
    began = int(wall_time() * 1e9)
    answers = agents.request_all(asked, _ANSWER_LIMIT)
    ended = int(wall_time() * 1e9)
    after, omitted = dict(command.after), 0
    lines: list[OutputLine] = []
    slow: dict[str, int] = {}  # by how much their clocks are at least [ns]
    for computer, answer in answers.items():
        if isinstance(answer, OutputLines):
            now = answer.now or ended
            slow[computer] = min(max(now, began), ended) - now
            lines += [replace(line, computer=computer) for line in answer.lines]
            omitted += answer.omitted
            if answer.lines:
                after[computer] = answer.lines[-1].at
    lines.sort(key=lambda line: line.at + slow[line.computer])
    last = lines[max(0, len(lines) - command.most) :]
    silent = [c for c, answer in answers.items() if not isinstance(answer, OutputLines)]
    omitted += len(lines) - len(last)
    return LogReading(tuple(last), after, omitted, tuple(sorted(silent)))


def _read_tap(live: LiveRobot, command: TapCommand) -> TapReading:
    """Return what has gone out since the viewer asked last; from any thread."""
    agents = live.agents
    by_ros2 = _by_ros2(live)
    for name in by_ros2:
        topic = name.rpartition(" ")[2]
        if command.connector in (name, topic):
            raise UsageError(
                f"'{command.connector}' is made by ROS 2 alone: `ros2 topic echo "
                f"{topic}` shows it"
            )
    statuses = agents.statuses()
    connector, computer, container = begin_of(statuses, command.connector, by_ros2)
    asked = Tap(
        number=secrets.randbits(_BITS),
        container=container,
        connector=connector,
        viewer=command.viewer,
        rate=command.rate,
        items=command.items,
        is_whole=command.is_whole,
        latest=command.latest,
        limit=_ANSWER_LIMIT,
    )
    reply = agents.request(computer, asked, _ANSWER_LIMIT)
    if isinstance(reply, TapReading):
        return reply
    if isinstance(reply, StepsFailed) and connector not in dict(_begins(statuses)):
        raise UsageError(reply.reason)  # the component has no such port
    why = f"no answer within {_ANSWER_LIMIT:g} s"
    if isinstance(reply, Refused | StepsFailed):
        why = reply.reason
    raise RunError(f"connector '{connector}' on '{computer}': {why}")


def begin_of(
    statuses: Statuses, asked: str, others: Iterable[str] = ()
) -> tuple[str, str, str]:
    """Return the connector, or port without one, and its computer and container.

    `others`: connectors that begin in no container.
    """
    found = dict(_begins(statuses))
    # of several, always the same: what others noted meanwhile would come too late
    sources = sorted(name for name in found if name.startswith(f"{asked}-"))
    targets = sorted(name for name in found if name.endswith(f"-{asked}"))
    names = [asked] if asked in found else sources or targets
    component = asked.rpartition(".")[0]
    if not names and (at := _container_of(statuses, component)):
        return (asked, *at)  # a port without a connector
    if not names:
        listed = "; ".join(sorted({*found, *others})) or "none"
        raise UsageError(f"no connector '{asked}' (there are: {listed})")
    if names == targets and len(names) > 1:
        raise UsageError(f"several connectors end at '{asked}': {'; '.join(names)}")
    return (names[0], *found[names[0]])


def _container_of(statuses: Statuses, component: str) -> tuple[str, str] | None:
    """Return the computer and container where a component is active."""
    for computer, status in sorted(statuses.items()):
        for container in status.containers:
            names = [c.name for c in container.components if c.state == "active"]
            if component in names:
                return computer, container.name
    return None


def _begins(statuses: Statuses) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield connectors and where they begin; where their source is active, last."""
    begins: list[tuple[bool, str, tuple[str, str]]] = []
    for computer, status in statuses.items():
        for container in status.containers:
            at_work = [c.name for c in container.components if c.state == "active"]
            sources = tuple(f"{name}{mark}" for name in at_work for mark in ".-")
            begins += (
                (end.name.startswith(sources), end.name, (computer, container.name))
                for end in container.connectors
                if end.end != "target"
            )
    for _, name, place in sorted(begins):
        yield name, place
