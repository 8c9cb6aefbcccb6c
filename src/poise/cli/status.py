"""`poise status`: how a running robot is."""

from __future__ import annotations

import sys

import msgspec
import typer

from poise.cli.move import AsJson, Robot
from poise.session.render.shown import console_to
from poise.session.running import Running


def status_command(robot: Robot = None, as_json: AsJson = False) -> None:
    """Show where a running robot's components are, and how they and connectors do.

    The exit code is 1 when anything is not as the robot file says.

    Example: poise status
    """
    status = Running(robot).status()
    if as_json:
        sys.stdout.write(msgspec.json.encode(status).decode() + "\n")
    else:
        console_to().print(status)
    if status.deviations:
        raise typer.Exit(1)
