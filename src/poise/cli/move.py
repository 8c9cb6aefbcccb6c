"""`poise move`: move a component of a running robot."""

from __future__ import annotations

import sys
from typing import Annotated

import msgspec
import typer

from poise.manage.control import (
    AskAlternative,
    AskMove,
    AskReplace,
    Moved,
    Replaced,
    ask,
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
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Move a component of a running robot to another computer.

    It keeps its state, and no call or message is lost, doubled or reordered. When
    something fails it goes on where it was, and the exit code is 1. A command-line
    component is stopped and started anew.

    Example: poise move localiser vision
    """
    show_move(ask(robot, AskMove(component, computer)), as_json=as_json)


def replace_command(
    what: Annotated[str, typer.Argument(help="The component, or an architecture.")],
    by: Annotated[
        str, typer.Argument(help="package.module:Class, or another architecture.")
    ],
    adapt: Annotated[
        str, typer.Option(help="package.module:function that maps the old state.")
    ] = "",
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Swap a running component's implementation, or a whole architecture.

    State is kept, and mapped by --adapt. An architecture is replaced by another that
    provides the same function: all its components take over at once, or none does.

    Example: poise replace localiser trot.navigator.scan_matcher:ScanMatcher
    """
    if ":" in by:
        show_move(ask(robot, AskReplace(what, by, adapt)), as_json=as_json)
    else:
        show_move(ask(robot, AskAlternative(what, by, adapt)), as_json=as_json)


def show_move(answer: object, *, as_json: bool) -> None:
    """Print what came of a move or replacement; exit with 1 when it was called off."""
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
    if isinstance(report, MoveReport) and report.short_stop:
        away = format_seconds(report.gate_shut)
        return f"{runs} now; started anew, away for {away}"
    return (
        f"{runs} now; prepared in {format_seconds(report.prepared)}, gate shut for "
        f"{format_seconds(report.gate_shut)}"
    )
