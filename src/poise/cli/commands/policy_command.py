"""`poise policy`: what a robot does by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from poise.cli.options import AsJson, RobotFile, print_json
from poise.errors import UsageError
from poise.model.load import load
from poise.model.policy.policy import Policy
from poise.model.policy.shipped import policies_of
from poise.session.recordings.policy_events import PolicyEvent, test_policies
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.units import format_seconds


def policy_command(
    what: Annotated[
        Literal["list", "test"],
        typer.Argument(
            help="list: what is done, and when; test: what would have been done."
        ),
    ],
    file: RobotFile,
    recording: Annotated[
        Path | None, typer.Option(help="For test: a file of `poise up --record`.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show the policies of a robot, those that Poise ships and its own, or test them.

    A test replays a recording of `poise up --record FILE`, and prints what the policies
    would have done when. Nothing is done.

    Examples
    --------
    poise policy list robot.yaml
    poise policy test robot.yaml --recording run.recording
    """
    robot, console = load(file), console_to(stderr=as_json)
    if what == "list":
        policies = policies_of(robot)
        if as_json:
            print_json(policies)
        else:
            _show(policies, console)
        return
    if recording is None:
        raise UsageError("give a recording: --recording FILE, of `poise up --record`")
    events = test_policies(
        robot, recording, say=lambda text: console.print(text, style="yellow")
    )
    if as_json:
        print_json(events)
    else:
        _show_events(events, console)


def _show(policies: tuple[Policy, ...], console: Console) -> None:
    rows = table("policy", "for each", "when", "lasts", "do", "cool down", folds=2)
    for each in policies:
        rows.add_row(
            each.name,
            each.for_each or "",
            each.when or each.call or "",
            format_seconds(each.lasts or 0.0),
            "off" if each.off else each.do or "",
            format_seconds(each.cool_down or 0.0),
        )
    console.print(rows)


def _show_events(events: tuple[PolicyEvent, ...], console: Console) -> None:
    rows = table("at [s]", "policy", "do", "what was seen", folds=3)
    for each in events:
        rows.add_row(f"{each.at:.1f}", each.policy, each.do or "", each.what)
    console.print(rows)
    if not events:
        console.print("the policies would have done nothing")
