"""`poise stop`: stop a running robot."""

from __future__ import annotations

import sys

from poise.cli.move import Robot
from poise.errors import RunError
from poise.manage.control_socket.client import send_command
from poise.manage.control_socket.records import StopCommand, StopReport


def stop_command(robot: Robot = None) -> None:
    """Stop a running robot, and wait until it has stopped.

    A move under way is rolled back. The exit code is 1 when something still runs.

    Example: poise stop
    """
    report = send_command(robot, StopCommand())
    assert isinstance(report, StopReport)  # noqa: S101, what the manager answers to it
    if report.remaining:
        raise RunError("\n".join(report.remaining))
    sys.stdout.write("stopped\n")
