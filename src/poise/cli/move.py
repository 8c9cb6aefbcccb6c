"""`poise move`: move a component of a running robot."""

from __future__ import annotations

import sys
from typing import Annotated

import msgspec
import typer

from poise.manage.desk import AskMove, AskReplace, Moved, ask
from poise.manage.move import MoveReport
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
    something fails it goes on where it was, and the exit code is 1.

    Example: poise move localiser vision
    """
    show_move(ask(robot, AskMove(component, computer)), as_json=as_json)


def replace_command(
    component: Annotated[str, typer.Argument(help="The component.")],
    implementation: Annotated[str, typer.Argument(help="package.module:Class")],
    adapt: Annotated[
        str, typer.Option(help="package.module:function that maps the old state.")
    ] = "",
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Swap the implementation of a running robot's component, keeping its state.

    Example: poise replace localiser trot.navigator.scan_matcher:ScanMatcher
    """
    what = AskReplace(component, implementation, adapt)
    show_move(ask(robot, what), as_json=as_json)


def show_move(answer: object, *, as_json: bool) -> None:
    """Print what came of a move; exit with 1 when it was called off."""
    assert isinstance(answer, Moved)  # noqa: S101, what the manager answers to these
    report = answer.report
    if as_json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        sys.stdout.write(_sentence(report) + "\n")
    if not report.committed:
        raise typer.Exit(1)


def _sentence(report: MoveReport) -> str:
    if not report.committed:
        return f"{report.component} stays on {report.source}: {report.reason}"
    return (
        f"{report.component} runs on {report.target} now; prepared in "
        f"{format_seconds(report.prepared)}, gate shut for "
        f"{format_seconds(report.gate_shut)}"
    )
