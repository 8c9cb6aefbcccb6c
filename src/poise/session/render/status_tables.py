"""How a running robot is, for people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from msgspec.structs import asdict
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from poise.clock import time_of_day
from poise.errors import last_error
from poise.manage.agent_connections.statuses import connectors_of, located
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.estimates import DemandEstimate, culprit_on
from poise.manage.tasks.task_reports import OVER, TaskReport
from poise.session.render.printable import Printable
from poise.session.render.tables import (
    chain_tables,
    clock_tables,
    connector_tables,
    failed_calls,
    table,
    task_lines,
)
from poise.units import counted, format_bytes, format_seconds, shortened
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
)


class Status(Printable, RobotStatus, frozen=True, tag="RobotStatus", kw_only=True):
    """A status that prints itself as tables, in a terminal and in a notebook."""

    @classmethod
    def of(cls, status: RobotStatus) -> Status:
        """Return a status that prints itself."""
        return cls(**asdict(status))

    def located(self) -> Sequence[tuple[str, ComponentStatus]]:
        """Yield the components that its computers report, each with its computer."""
        return located(self.computers)

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(status_parts(self))

    def details(self) -> tuple[RenderableType, ...]:
        """Return what `poise status --all` adds."""
        return tuple(detail_parts(self))


def status_parts(status: RobotStatus) -> Iterator[RenderableType]:
    """Yield a status: deviations first."""
    yield f"robot '{status.robot}'"
    tasks = tuple(_latest(status.tasks))
    yield from task_lines(tasks)
    if switches := str(status.prefetch):
        yield f"switches from action to action: {switches}"
    yield f"{'last ' if status.by_agents else ''}managed by {status.manager}"
    for computer, report in sorted(status.computers.items()):
        if report.manager is not None and report.manager != status.manager:
            yield f"[yellow]the agent of '{computer}' obeys {report.manager}[/]"
    yield from map(Text, status.under_way)
    for each in status.deviations:
        yield Text(f"{each.what} (noticed {time_of_day(each.since)})", style="red")
    unknown = status.not_known()
    if unknown:
        yield f"[red]not known how these are now: {', '.join(sorted(unknown))}[/]"
    elif not status.deviations:
        faults = counted(status.faults, "fault")
        lately = f"; {faults} since the start (below)" if status.faults else ""
        is_rest = status.under_way or any(task.state == "failed" for task in tasks)
        everything = "everything else" if is_rest else "everything"
        yield f"{everything} is as the robot file says{lately}"
    for name, values in sorted(status.parameters.items()):
        said = ", ".join(f"{key} = {shortened(value)}" for key, value in values.items())
        yield Text(f"parameters of '{name}' that were set since the start: {said}")
    yield component_table(status)
    for remark in remarks(status):
        yield f"[yellow]{remark}[/]"
    yield from chain_tables(status.chains)
    yield from _old_chains(status)
    yield computer_table(status)
    for line in (
        *growing_containers(status),
        *container_lines(status),
        *failed_calls(connectors_of(status.computers)),
        *_notices(status),
    ):
        yield Text(line, style="yellow")


def _old_chains(status: RobotStatus) -> Iterator[str]:
    """Yield of which chains nothing is known now, if of any."""
    unknown = status.not_known()
    at = {chain.name: {hop.computer for hop in chain.hops} for chain in status.chains}
    if old := ", ".join(name for name, computers in at.items() if computers & unknown):
        yield f"[red]not known how old this data is now: {old}[/]"


def detail_parts(status: RobotStatus) -> Iterator[RenderableType]:
    """Yield what `poise status --all` adds: connectors, clocks and containers."""
    if tables := connector_tables(connectors_of(status.computers)):
        yield from tables
        yield "counted since each component began to run where it is, or restarted"
    known = {name: each.clocks for name, each in sorted(status.computers.items())}
    yield from clock_tables(known)
    yield container_table(status)
    means = {name: each.cpu_weights for name, each in sorted(status.computers.items())}
    if by := ", ".join(f"{how} on {name}" for name, how in means.items() if how):
        yield f"containers share the CPU by priority: {by}"


def component_table(answer: RobotStatus) -> Table:
    """Return where components are, or should be, and what they need, by computer."""
    rows = table("component", "computer", "state", "CPU", "profile", folds=1)
    unknown, missing = answer.not_known(), dict(answer.placement)
    for computer, component, standing in _each(answer):
        missing.pop(component.name, None)
        state: str = component.state
        is_prepared = answer.prefetch.prepared.get(component.name) == computer
        if state == "inactive" and is_prepared:
            state = "prepared"
        needs = _needs(standing)
        if computer in unknown:
            state, needs = "unknown", ("", needs[1])
        rows.add_row(component.name, computer, state, *needs)
    for name, computer in sorted(missing.items()):
        state = "unknown" if computer in unknown else "[red]not there[/]"
        rows.add_row(name, computer, state)
    return rows


def computer_table(answer: RobotStatus) -> Table:
    """Return what is used of each computer, how old that figure is, and restarts."""
    unknown, columns = answer.not_known(), ["containers", "restarts"]
    columns += ["reported"] if unknown else []
    rows = table("computer", "CPU", "memory", *columns)
    for name in sorted({*answer.computers, *unknown}):
        computer, age = answer.computers.get(name), answer.ages.get(name)
        heard = "" if age is None else f"{format_seconds(age)} ago"
        if computer is None:
            rows.add_row(name, *["not known"] * 4, "never")
            continue
        running = [h for h in computer.health if h.state != "stopped"]
        others = answer.background(name)
        by_others = f", {others:.2f} by other programs" if others else ""
        by_others = " by Poise alone" if others is None else by_others
        rows.add_row(
            name,
            f"{computer.load + (others or 0):.2f} cores{by_others}",
            format_bytes(computer.memory),
            str(len(running)),
            str(sum(health.restarts for health in computer.health)),
            *[heard] * bool(unknown),
        )
    return rows


def container_table(answer: RobotStatus) -> Table:
    """Return the memory of containers, how fast it grows, and what was planned."""
    names = "container", "computer", "memory", "demand", "grows", "components"
    rows = table(*names, folds=len(names) - 1)
    for name, computer in _known(answer):
        inside = {each.name: each.components for each in computer.containers}
        for health in computer.health:
            if health.name not in inside:
                continue
            components = [component.name for component in inside[health.name]]
            demand = sum(answer.memory_demands.get(each, 0.0) for each in components)
            text = format_bytes(health.memory)
            rows.add_row(
                health.name,
                name,
                f"[yellow]{text}[/]" if 0 < demand < health.memory else text,
                format_bytes(demand) if demand else "",
                f"[yellow]{_growth(health)}[/]",
                ", ".join(components),
            )
    return rows


def _known(answer: RobotStatus) -> list[tuple[str, AgentStatus]]:
    """Return the computers of which it is known how they are now, by name."""
    unknown = answer.not_known()
    return [each for each in sorted(answer.computers.items()) if each[0] not in unknown]


def _growth(health: ContainerHealth) -> str:
    if not health.growth:
        return ""
    limit = f"{format_bytes(health.limit)} in {format_seconds(health.full_in)}"
    return f"{format_bytes(health.growth)}/s: {limit}"


def growing_containers(answer: RobotStatus) -> Iterator[str]:
    """Give the containers whose memory grows towards its limit."""
    for computer, status in _known(answer):
        for health in status.health:
            if growth := _growth(health):
                name = f"container '{health.name}' on '{computer}'"
                yield f"the memory of {name} grows by {growth}"


def container_lines(answer: RobotStatus) -> Iterator[str]:
    """Give the state and the last fault of each container that had one."""
    for computer, status in sorted(answer.computers.items()):
        for health in status.health:
            fault = health.last_fault
            if fault is None:
                continue
            restarts = counted(health.restarts, "restart")
            if health.restarts and health.state == "running":
                restarts += " (counters began again then)"
            yield (
                f"container '{health.name}' on '{computer}': {health.state} since "
                f"{time_of_day(health.since)}, {restarts}; last fault at "
                f"{time_of_day(fault.at)}: {fault.message}"
            )


def _notices(answer: RobotStatus) -> Iterator[str]:
    for each in answer.lost_states:
        yield f"{each.what} ({time_of_day(each.since)})"
    if answer.notice:
        yield f"manager: {answer.notice}"
    versions = {report.version for report in answer.computers.values()}
    for name, report in sorted(answer.computers.items()):
        if report.notice:
            yield f"{name}: {report.notice}"
        if len(versions) > 1:
            yield f"{name}: Poise {report.version}"


def remarks(answer: RobotStatus) -> Iterator[str]:
    """Give what is wrong with components, a line for each, by computer."""
    unknown = answer.not_known()
    for computer, component, standing in _each(answer):
        load = answer.loads.get(computer)
        culprit = culprit_on(load, answer.demand_estimates, component.name)
        now = standing if computer not in unknown else None
        if found := ", ".join(_remarks(component, now, culprit)):
            yield f"{component.name}: {found}"


def _each(
    answer: RobotStatus,
) -> Iterator[tuple[str, ComponentStatus, DemandEstimate | None]]:
    demand_estimates = {each.component: each for each in answer.demand_estimates}
    for computer, component in located(answer.computers):
        yield computer, component, demand_estimates.get(component.name)


def _latest(tasks: Iterable[TaskReport]) -> Iterator[TaskReport]:
    """Yield what is not over, and the last start of each task that is."""
    tasks = tuple(tasks)
    last = {task.name: task for task in tasks}
    for task in tasks:
        if task.state not in OVER or task is last[task.name]:
            yield task


def _remarks(
    component: ComponentStatus, standing: DemandEstimate | None, culprit: str = ""
) -> Iterator[str]:
    if component.errors:
        last = last_error(component.error)
        which = f" ({escape(last)})" if last else ""
        yield f"{counted(component.errors, 'error')}{which}"
    if standing is not None and component.state == "active":  # not when it was so
        now = standing.estimate
        if now.starved:
            why = f" ({culprit})" if culprit else ""
            yield f"starved {now.starved:.0%}{why}"
        if now.long_job:
            what = f"'{component.handler}'" if component.handler else "a job"
            lasted = format_seconds(now.long_job)
            yield f"{what} has computed for {lasted} and not ended"
    for timer in component.timers:
        if timer.deadline is not None and timer.missed:
            missed = f"{timer.missed:,} of {timer.releases:,} deadlines"
            yield f"{timer.name} missed {missed}"


def _needs(standing: DemandEstimate | None) -> tuple[str, str]:
    """Return what a component needs now, and what its profile says."""
    if standing is None:
        return "", ""
    now, expected = standing.estimate, standing.expected
    text = f"{now.mean:.1%}"
    if now.is_least or (now.error is None and now.starved):
        text = f"at least {text}"
    elif now.error is not None:
        text += f" ± {now.error:.1%}"
    if now.drift:
        text = f"[yellow]{text}[/]"
    return text, "" if expected is None else f"{expected:.1%}"
