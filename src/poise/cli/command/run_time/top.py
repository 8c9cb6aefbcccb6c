"""`poise top`: a running robot in a terminal."""

from __future__ import annotations

from typing import Annotated

import typer

from poise.cli.command.run_time.running_robot import Robot
from poise.errors import UsageError
from poise.session.running_robots.running import connect


def top_command(
    every: Annotated[
        float, typer.Option(min=0.2, help="Look again after so many seconds.")
    ] = 1.0,
    robot: Robot = None,
) -> None:
    """Watch a running robot: computers, components, connectors and last decisions.

    Works over ssh in 60 x 24 characters. Tab goes from table to table, s sorts by the
    next column, r the other way round, q quits. It goes on when the manager is
    restarted.

    Example: poise top
    """
    try:
        from poise.view.top import Top
    except ImportError as error:
        raise UsageError("poise top needs textual: pip install 'poise[top]'") from error
    Top(connect(robot).status, every).run()
