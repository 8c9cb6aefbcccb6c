"""`poise status`: how a running robot is."""

from __future__ import annotations

import sys

import msgspec
from rich.console import Console
from rich.table import Table

from poise.cli.clocks import clock_table
from poise.cli.connectors import connector_tables
from poise.cli.move import AsJson, Robot
from poise.cli.tables import table
from poise.manage.desk import AskStatus, RobotStatus, ask
from poise.manage.estimates import Standing
from poise.manage.report import clocks_of
from poise.manage.run import connectors_of
from poise.wire.messages import TimerStatus


def status_command(robot: Robot = None, as_json: AsJson = False) -> None:
    """Show where a running robot's components are, and how they and connectors do.

    Example: poise status
    """
    answer = ask(robot, AskStatus())
    assert isinstance(answer, RobotStatus)  # noqa: S101, what the manager answers
    if as_json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
        return
    console = Console(highlight=False)
    console.print(f"robot '{answer.robot}', task '{answer.task}'")
    for name in answer.lost:
        console.print(f"[red]computer '{name}' is lost[/]")
    console.print(_components(answer))
    for rows in connector_tables(connectors_of(answer.computers)):
        console.print(rows)
    clocks = clock_table(clocks_of(answer.computers))
    if clocks.row_count:
        console.print(clocks)
    for name, computer in answer.computers.items():
        for fault in computer.faults:
            console.print(f"[red]{name}: container '{fault.container}' {fault.message}")


def _components(answer: RobotStatus) -> Table:
    rows = table(
        "component", "computer", "state", "CPU", "profile", "errors", "missed deadlines"
    )
    standings = {each.component: each for each in answer.standings}
    for computer, status in sorted(answer.computers.items()):
        for container in status.containers:
            for component in container.components:
                missed = ", ".join(map(_missed, component.timers))
                errors = str(component.errors or "")
                needs = _needs(standings.get(component.name))
                rows.add_row(
                    component.name, computer, component.state, *needs, errors, missed
                )
    return rows


def _needs(standing: Standing | None) -> tuple[str, str]:
    """Return what a component needs now, and what its profile says."""
    if standing is None:
        return "", ""
    now, expected = standing.estimate, standing.expected
    error = f" ± {now.error:.1%}" if now.error is not None else ""
    starved = f", starved {now.starved:.0%}" if now.starved else ""
    colour = "yellow" if now.drift else "default"
    text = f"[{colour}]{now.mean:.1%}{error}{starved}[/]"
    return text, "" if expected is None else f"{expected:.1%}"


def _missed(timer: TimerStatus) -> str:
    if timer.deadline is None or not timer.releases:
        return ""
    return f"{timer.name} {timer.missed / timer.releases:.1%}"
