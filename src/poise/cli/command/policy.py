"""`poise policy`: what a robot does by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from poise.cli.options import AsJson, print_json
from poise.model.load import load
from poise.model.policy.policy import Policy
from poise.model.policy.shipped import policies_of
from poise.session.render.shown import console_to
from poise.session.render.tables import table
from poise.units import format_seconds


def policy_command(
    what: Annotated[
        Literal["list"], typer.Argument(help="list: what is done, and when.")
    ],
    file: Annotated[Path, typer.Argument(envvar="POISE_ROBOT", help="The robot file.")],
    as_json: AsJson = False,
) -> None:
    """Show the policies of a robot: those that Poise ships, and its own.

    Examples
    --------
    poise policy list robot.yaml
    """
    del what
    policies = policies_of(load(file))
    if as_json:
        print_json(policies)
    else:
        _show(policies, console_to())


def _show(policies: tuple[Policy, ...], console: Console) -> None:
    rows = table("policy", "for each", "when", "lasts", "do", "cool down", folds=2)
    for each in policies:
        rows.add_row(
            each.name,
            str(each.for_each or ""),
            each.when or "",
            format_seconds(each.lasts or 0.0),
            "off" if each.off else str(each.do or ""),
            format_seconds(each.cool_down or 0.0),
        )
    console.print(rows)
