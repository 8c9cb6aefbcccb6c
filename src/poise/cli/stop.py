"""`poise stop`: stop a running robot."""

from __future__ import annotations

import sys

from poise.cli.move import Robot
from poise.manage.control import AskStop, ask


def stop_command(robot: Robot = None) -> None:
    """Stop a running robot.

    Example: poise stop
    """
    ask(robot, AskStop())
    sys.stdout.write("stopping\n")
