"""`poise stop`: stop a running robot."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.move import Robot
from poise.model import load
from poise.session.running import Running
from poise.session.stop import stop_without_manager


def stop_command(
    robot: Robot = None,
    file: Annotated[
        Path | None,
        typer.Option(help="Robot file: end what a killed manager left running."),
    ] = None,
) -> None:
    """Stop a running robot, and wait until it has stopped.

    A move under way is rolled back. The exit code is 1 when something still runs. With
    --file it needs no manager: it ends all containers on the computers of the robot.

    Example: poise stop
    """
    if file is None:
        Running(robot).stop()
    else:
        stop_without_manager(load(file))
    sys.stdout.write("stopped\n")
