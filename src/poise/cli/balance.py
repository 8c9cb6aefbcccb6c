"""`poise balance`: find a better placement for what a running robot needs now."""

from __future__ import annotations

import math
import sys
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.markup import escape

from poise.cli.move import AsJson, Robot
from poise.errors import UsageError
from poise.manage.adaptation.replan import Proposal
from poise.manage.control_socket.client import send_command
from poise.manage.control_socket.records import RebalanceCommand, Rebalanced
from poise.manage.migration.transition_run import TransitionReport
from poise.units import format_seconds


def balance_command(
    cost: Annotated[
        float,
        typer.Option(help="What F grows by for a move, and for each MB of its state."),
    ] = 0.01,
    dry: Annotated[
        bool, typer.Option("--dry-run", help="Say what is best; move nothing.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Find a better placement for what a running robot needs now, and go there.

    Components move, one after the other, so that no computer is overfull midway. When
    one cannot, all go back to where they were, and the exit code is 1.

    Example: poise balance --dry-run
    """
    if not (math.isfinite(cost) and cost >= 0):
        raise UsageError(f"--cost {cost:g}: it is a number that is not negative")
    answer = send_command(robot, RebalanceCommand(cost, dry))
    assert isinstance(answer, Rebalanced)  # noqa: S101, what the manager answers to it
    if as_json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
    else:
        console = Console(highlight=False)
        _show_proposal(answer.proposal, console)
        if answer.report is not None:
            _show_report(answer.report, console)
    if answer.report is not None and not answer.report.committed:
        raise typer.Exit(1)


def _show_proposal(proposal: Proposal, console: Console) -> None:
    for name, need in proposal.shifted.items():
        console.print(f"{name} needs {need}")
    if proposal.trouble:
        console.print(f"[red]as it is: {proposal.trouble}[/]")
    known = " (proven the best)" if proposal.proven else ""
    if not proposal.steps:
        console.print(f"best as it is{known}: F = {proposal.now.total:.4g}")
        return
    console.print(
        f"F = {proposal.now.total:.4g} becomes {proposal.then.total:.4g}{known}, by:"
    )
    for step in proposal.steps:
        console.print(f"  {step}")


def _show_report(report: TransitionReport, console: Console) -> None:
    if not report.committed:
        console.print(f"[red]rolled back:[/] {escape(report.reason)}")
        return
    longest = max((move.downtime for move in report.moves), default=0.0)
    downtime = f"; the longest downtime was {format_seconds(longest)}"
    console.print(f"done{downtime if report.moves else ''}")
