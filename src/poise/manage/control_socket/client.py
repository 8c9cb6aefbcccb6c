"""Sends a command to the manager of a running robot."""

from __future__ import annotations

import select
import socket
from typing import TypeVar

from poise.errors import RunError, Timeout
from poise.manage.control_socket.location import find
from poise.manage.control_socket.records import Command, Refusal, Response, Result
from poise.wire import record_channel
from poise.wire.codec import WireError
from poise.wire.connections.socket_path import connect

R = TypeVar("R", bound=Result)

ANSWER_LIMIT = 60.0
"""The manager answers within this time [s]; moves of large states take the longest."""


def send_command(robot: str | None, command: Command) -> Result:
    """Send a command to the manager of a running robot, and return its result.

    Parameters
    ----------
    robot
        Its name; None when only one runs.

    Raises
    ------
    UsageError
        No such robot runs, or several do and none is named; or the manager refuses.
    RobotError
        The manager refuses because of the robot file.
    RunError
        The manager does not answer within `ANSWER_LIMIT`, or could not do it.
    """
    path = find(robot)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connect(connection, path, record_channel.LIMIT)
            record_channel.send(connection, command)
            if not select.select([connection], [], [], ANSWER_LIMIT)[0]:
                raise Timeout(
                    f"it is busy since {ANSWER_LIMIT:g} s; what it has begun goes on, "
                    "and `poise status` shows the outcome"
                )
            told: Response = record_channel.receive(connection, Response)
    except (OSError, RunError, WireError) as error:
        raise RunError(f"robot '{path.stem}' gave no answer: {error}") from error
    if isinstance(told, Refusal):
        raise told.to_error()
    return told


def ask(robot: str | None, command: Command, type_: type[R]) -> R:
    """Return the result of a command, which is of a type; raises as `send_command`."""
    result = send_command(robot, command)
    if not isinstance(result, type_):
        raise RunError(f"the manager answered {result!r} to {command!r}")
    return result
