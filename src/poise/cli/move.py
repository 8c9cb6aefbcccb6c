"""`poise move`: move a component of a running robot."""

from __future__ import annotations

import sys
from typing import Annotated

import msgspec
import typer

from poise.manage.control_socket.client import send_command
from poise.manage.control_socket.records import (
    MoveCommand,
    Moved,
    ReplaceCommand,
    Replaced,
)
from poise.manage.migration.move import MoveReport
from poise.manage.migration.replacement import ReplaceReport
from poise.units import format_seconds

Robot = Annotated[
    str | None, typer.Option(help="The robot's name, when several run here.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")]


def move_command(
    component: Annotated[str, typer.Argument(help="The component.")],
    computer: Annotated[str, typer.Argument(help="Where it is to run.")],
    force: Annotated[
        bool, typer.Option("--force", help="Move it even where it does not fit.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Move a component of a running robot to another computer.

    It keeps its state, and no call or message is lost, doubled or reordered. When
    something fails it goes on where it was, and the exit code is 1. A command-line
    component is stopped and started. A component that does not fit beside what
    runs on the computer is refused, unless --force is given.

    Example: poise move localiser vision
    """
    command = MoveCommand(component, computer, force)
    show_move(send_command(robot, command), as_json=as_json)


def replace_command(
    what: Annotated[str, typer.Argument(help="The component, or an architecture.")],
    by: Annotated[
        str, typer.Argument(help="package.module:Class, or another architecture.")
    ],
    adapt: Annotated[
        str, typer.Option(help="package.module:function that maps the old state.")
    ] = "",
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Drop the old state and begin without.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Swap a running component's implementation, or a whole architecture.

    State is kept: --adapt maps it where it is another one, and --fresh drops it. An
    architecture is replaced by another that provides the same function: all its
    components take over at once, or none does.

    Example: poise replace localiser trot.navigator.scan_matcher:ScanMatcher
    """
    command = ReplaceCommand(what, by, adapt, fresh)
    show_move(send_command(robot, command), as_json=as_json)


def show_move(answer: object, *, as_json: bool) -> None:
    """Print the outcome of a move or replacement; exit with 1 if rolled back."""
    assert isinstance(answer, Moved | Replaced)  # noqa: S101, what is answered to these
    report = answer.report
    if as_json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        sys.stdout.write(_sentence(report) + "\n")
    if not report.committed:
        raise typer.Exit(1)


def _sentence(report: MoveReport | ReplaceReport) -> str:
    if isinstance(report, MoveReport):
        stays = f"{report.component} stays on {report.source}"
        runs = f"{report.component} runs on {report.target}"
    else:
        stays, runs = f"{report.architecture} goes on", f"{report.by} runs"
    if not report.committed:
        return f"{stays}: {report.reason}"
    if isinstance(report, MoveReport) and report.cold:
        downtime = format_seconds(report.downtime)
        return f"{runs} now; it was stopped and started, downtime {downtime}"
    return (
        f"{runs} now; prepared in {format_seconds(report.prepared)}, downtime "
        f"{format_seconds(report.downtime)}"
    )
