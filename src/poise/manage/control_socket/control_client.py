"""Sends a command to the manager of a running robot, wherever on it that runs."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import zenoh

from poise.errors import RunError, Timeout, UsageError
from poise.kernel_counters import process_stat
from poise.manage.control_socket.agents_without_manager import (
    NoManager,
    ask_agents,
    robots_without_manager,
)
from poise.manage.control_socket.commands import (
    Command,
    JournalCommand,
    LogCommand,
    Refusal,
    Response,
    Result,
    RobotStatus,
    StatusCommand,
    TapCommand,
)
from poise.wire import frame
from poise.wire.address import connect
from poise.wire.codec import WireError
from poise.wire.control_session import LEASE, close_session, open_session
from poise.wire.robots_here import noted_of, path_of, peer_of, running_here

_LOOKS = StatusCommand | JournalCommand | TapCommand | LogCommand
"""Commands that change nothing."""
R = TypeVar("R", bound=Result)

ANSWER_LIMIT = 60.0
"""The manager answers within this time [s]; moves of large states take the longest."""
STATUS_LIMIT = 10.0
"""It gives its status within this time [s], whatever it does: else it does not work."""
_LOOK_EVERY = 1.0
_CHANGE_LIMIT = 5.0
"""A standby leads within this time [s], if one can."""
_ASK_EVERY = 0.1


def send_command(robot: str | None, command: Command) -> Result:
    """Send a command to the manager of a running robot, and return its result.

    `robot`: its name; None when only one runs. When its manager is on another computer,
    an agent passes the command on, as soon as a standby leads if the manager is gone.
    """
    where = _find(robot)
    name = where.stem if isinstance(where, Path) else where.robot
    try:
        told = (
            _told_here(where, command)
            if isinstance(where, Path)
            else _told_elsewhere(where, command)
        )
    except NoManager:
        raise
    except BlockingIOError:  # its queue is full
        raise _no_answer(name) from None
    except (OSError, RunError, WireError) as error:
        done = "" if isinstance(command, _LOOKS) else "; it may have been done"
        raise RunError(f"robot '{name}' gave no answer: {error}{done}") from error
    if isinstance(told, Refusal):
        raise told.to_error()
    return told


def ask(robot: str | None, command: Command, type_: type[R]) -> R:
    """Return the result of a command, which is of a type; raises as `send_command`."""
    result = send_command(robot, command)
    if not isinstance(result, type_):
        raise RunError(f"the manager answered {result!r} to {command!r}")
    return result


def _find(robot: str | None) -> Path | RobotStatus:
    """Return the control socket of a running robot; None: of the only one.

    A status: its manager is on another computer, or comes.
    """
    managed = running_here()
    if robot in managed:
        return path_of(robot)
    left = robots_without_manager(but=managed)
    names = sorted([*managed, *left])
    if robot is None and len(names) > 1:
        said = ", ".join(n if n in managed else f"{n}, no manager" for n in names)
        raise UsageError(f"several robots run ({said}): name one with --robot")
    if robot is None and managed:
        return path_of(managed[0])
    status = left.get(robot or "".join(names))
    if status is not None:
        is_gone = all(agent.unmanaged for agent in status.computers.values())
        if not is_gone or any(
            agent.has_standbys for agent in status.computers.values()
        ):
            return status
        addresses = noted_of(status.robot)
        raise NoManager(status.deviations[0].what, status, addresses)
    which = f"robot '{robot}' does not run" if robot else "no robot runs"
    raise UsageError(
        f"{which} here (running: {', '.join(names) or 'none'}); `poise up FILE` starts "
        "one, and `poise status --file FILE` asks the agents of one that was started "
        "elsewhere"
    )


def _told_here(path: Path, command: Command) -> Response:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connect(connection, path, frame.RECORD_LIMIT)
        frame.send_record(connection, command)
        _wait(connection, path, command)
        told: Response = frame.receive_record(connection, Response)
        return told


def _told_elsewhere(status: RobotStatus, command: Command) -> Response:
    """Return what a manager says that runs beside another agent, once one does."""
    robot, until = status.robot, time.monotonic() + _CHANGE_LIMIT
    addresses = noted_of(robot)
    if addresses is None:  # it has just stopped
        raise RunError("it has stopped")
    keys = addresses.credentials()
    session = open_session(
        connect=tuple(addresses.endpoints.values()), lease=LEASE, keys=keys
    )
    try:
        while True:
            for key, _ in _replies(session, f"poise/{robot}/control/*", b"", 1.0):
                limit = STATUS_LIMIT if _is_quick(command) else ANSWER_LIMIT
                packet = frame.pack_record(command)
                for _, told in _replies(session, key, packet, limit):
                    return frame.unpack_record(told, Response)  # type: ignore[no-any-return]
                raise RunError("its manager has ended, or is too busy")
            if time.monotonic() >= until:
                why = status.deviations[0].what
                if keys is not None and keys.role == "viewer":
                    why += f" (the keys in {keys.folder} only let look at its agents)"
                raise NoManager(why, status)
            time.sleep(_ASK_EVERY)
    finally:
        close_session(session)


def _replies(
    session: zenoh.Session, key: str, packet: bytes, limit: float
) -> Iterator[tuple[str, bytes]]:
    """Yield what agents answer, by key, but for those that have no manager."""
    for reply in session.get(key, payload=packet, timeout=limit):
        if reply.ok is None:
            raise RunError(reply.err.payload.to_string() if reply.err else "no answer")
        if data := reply.ok.payload.to_bytes():
            yield str(reply.ok.key_expr), data


def _is_quick(command: Command) -> bool:
    return isinstance(command, StatusCommand | JournalCommand)


def _wait(connection: socket.socket, path: Path, command: Command) -> None:
    """Wait for the answer to a command for as long as the manager works."""
    manager, began, patience = peer_of(connection), time.monotonic(), STATUS_LIMIT
    while not select.select([connection], [], [], _LOOK_EVERY)[0]:
        waited = time.monotonic() - began
        if _is_stopped(manager):
            raise _no_answer(path.stem, manager, waited)
        if waited < patience:
            continue
        if _is_quick(command) or not _gives_status(path):
            raise _no_answer(path.stem, manager, waited)
        if waited >= ANSWER_LIMIT:
            raise Timeout(
                f"the manager has been busy for {ANSWER_LIMIT:g} s; its work "
                "continues, and `poise status` shows the outcome"
            )
        patience = waited + STATUS_LIMIT


def _gives_status(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            connect(connection, path, frame.RECORD_LIMIT)
            frame.send_record(connection, StatusCommand())
        except (OSError, RunError, WireError):
            return False
        return bool(select.select([connection], [], [], STATUS_LIMIT)[0])


def _no_answer(robot: str, manager: int | None = None, waited: float = 0) -> NoManager:
    """Return what is known of a manager that is there, and silent.

    `manager`: its process; None: it takes no more connections; `waited`: for how long
    [s].
    """
    why = f"the manager of robot '{robot}' takes no more connections"
    if manager is not None:
        why = f"the manager of robot '{robot}' (process {manager}) has not answered "
        why += f"for {waited:.0f} s"
        if _is_stopped(manager):
            why += f": it is stopped, and `kill -CONT {manager}` lets it go on"
    why += "; `poise up --take-over FILE` replaces it"
    addresses = noted_of(robot)
    status = ask_agents(addresses, why) if addresses is not None else None
    return NoManager(status.deviations[0].what if status else why, status)


def _is_stopped(pid: int) -> bool:
    stat = process_stat(pid)
    return stat is not None and stat.is_stopped
