"""`poise status`: how a running robot is."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import msgspec
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from poise.cli.move import AsJson, Robot
from poise.manage.control_socket.client import send_command
from poise.manage.control_socket.records import RobotStatus, StatusCommand
from poise.manage.observe.estimates import DemandEstimate
from poise.manage.run import connectors_of
from poise.session.render.clocks import clock_table
from poise.session.render.connectors import connector_tables
from poise.session.render.tables import table
from poise.session.report import clocks_of
from poise.units import format_bytes
from poise.wire.records.deployment import ComponentStatus


def status_command(robot: Robot = None, as_json: AsJson = False) -> None:
    """Show where a running robot's components are, and how they and connectors do.

    The exit code is 1 when anything is not as the robot file says.

    Example: poise status
    """
    answer = send_command(robot, StatusCommand())
    assert isinstance(answer, RobotStatus)  # noqa: S101, what the manager answers
    if as_json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
    else:
        show_status(answer, Console(highlight=False))
    if answer.deviations:
        raise typer.Exit(1)


def show_status(answer: RobotStatus, console: Console) -> None:
    """Print a status: deviations first."""
    console.print(f"robot '{answer.robot}', task '{answer.task}'")
    console.print(f"managed by {answer.manager}")
    for each in answer.deviations:
        console.print(Text(f"{each.what} (noticed {_clock(each.since)})", style="red"))
    if not answer.deviations:
        console.print("everything is as the robot file says")
    console.print(component_table(answer))
    for remark in remarks(answer):
        console.print(f"[yellow]{remark}[/]")
    for rows in connector_tables(connectors_of(answer.computers)):
        console.print(rows)
    clocks = clock_table(clocks_of(answer.computers))
    if clocks.row_count:
        console.print(clocks)
    console.print(computer_table(answer))
    for line in container_lines(answer):
        console.print(Text(line, style="yellow"))


def component_table(answer: RobotStatus) -> Table:
    """Return where components are and what they need, by computer."""
    rows = table("component", "computer", "state", "CPU", "profile", folds=1)
    for computer, component, standing in _each(answer):
        rows.add_row(component.name, computer, component.state, *_needs(standing))
    return rows


def computer_table(answer: RobotStatus) -> Table:
    """Return what agents and containers use of each computer, and what restarted."""
    rows = table("computer", "CPU", "memory", "containers", "restarts")
    for name, computer in sorted(answer.computers.items()):
        running = [h for h in computer.health if h.state != "stopped"]
        rows.add_row(
            name,
            f"{computer.load:.2f} cores",
            format_bytes(computer.memory),
            str(len(running)),
            str(sum(health.restarts for health in computer.health)),
        )
    return rows


def container_lines(answer: RobotStatus) -> Iterator[str]:
    """Give the state and the last fault of each container that had one."""
    for computer, status in sorted(answer.computers.items()):
        for health in status.health:
            fault = health.last_fault
            if fault is None:
                continue
            yield (
                f"container '{health.name}' on '{computer}': {health.state} since "
                f"{_clock(health.since)}, {health.restarts} restarts; last fault at "
                f"{_clock(fault.at)}: {fault.message}"
            )


def _clock(moment: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(moment))


def remarks(answer: RobotStatus) -> Iterator[str]:
    """Give what is wrong with components, a line for each, by computer."""
    for _, component, standing in _each(answer):
        found = ", ".join(_remarks(component, standing))
        if found:
            yield f"{component.name}: {found}"


def _each(
    answer: RobotStatus,
) -> Iterator[tuple[str, ComponentStatus, DemandEstimate | None]]:
    demand_estimates = {each.component: each for each in answer.demand_estimates}
    for computer, status in sorted(answer.computers.items()):
        for container in status.containers:
            for component in container.components:
                yield computer, component, demand_estimates.get(component.name)


def _remarks(
    component: ComponentStatus, standing: DemandEstimate | None
) -> Iterator[str]:
    if component.errors:
        last = component.error.rstrip().rpartition("\n")[2]
        yield f"{component.errors} errors" + (f" ({escape(last)})" if last else "")
    if standing is not None and standing.estimate.starved:
        yield f"starved {standing.estimate.starved:.0%}"
    for timer in component.timers:
        if timer.deadline is not None and timer.missed:
            share = timer.missed / timer.releases
            yield f"{timer.name} missed {share:.1%} of deadlines"


def _needs(standing: DemandEstimate | None) -> tuple[str, str]:
    """Return what a component needs now, and what its profile says."""
    if standing is None:
        return "", ""
    now, expected = standing.estimate, standing.expected
    text = f"{now.mean:.1%}"
    if now.error is not None:
        text += f" ± {now.error:.1%}"
    elif now.starved:
        text = f"at least {text}"
    if now.drift:
        text = f"[yellow]{text}[/]"
    return text, "" if expected is None else f"{expected:.1%}"
