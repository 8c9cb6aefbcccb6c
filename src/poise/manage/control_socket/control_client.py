"""Sends a command to the manager of a running robot, wherever on it that runs."""

from __future__ import annotations

import socket
import time
from collections.abc import Collection, Sequence
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
    LookCommand,
    RecordCommand,
    Refusal,
    Response,
    Result,
    StatusCommand,
)
from poise.waker import wait_readable
from poise.wire import frame
from poise.wire.address import connect
from poise.wire.codec import WireError
from poise.wire.control_session import COMMAND_LIMIT, close_session, open_session
from poise.wire.robots_here import (
    AgentAddresses,
    noted,
    noted_of,
    path_of,
    peer_of,
    running_here,
)

R = TypeVar("R", bound=Result)

STATUS_LIMIT = 10.0
"""It gives its status within this time [s], whatever it does: else it does not work."""
_LOOK_EVERY = 1.0
_REACH_LIMIT = 0.5
"""A manager elsewhere answers within this time [s], or agents are asked why not."""
_PROBE_LIMIT = 0.5
_CHANGE_LIMIT = 5.0
"""A standby leads within this time [s], if one can."""
_ASK_EVERY = 0.1


def send_command(robot: str | AgentAddresses | None, command: Command) -> Result:
    """Send a command to the manager of a running robot, and return its result.

    `robot`: its name, or its agents; None when only one runs. An agent passes the
    command on to a manager elsewhere, or to the standby that leads once that is gone.
    """
    try:
        where = _find(robot)
    except OSError as error:  # no descriptor is free, say
        raise RunError(f"no robot can be looked for: {error}") from error
    name = where.stem if isinstance(where, Path) else where.robot
    try:
        told = (
            _told_here(where, command)
            if isinstance(where, Path)
            else _told_elsewhere(where, command)
        )
    except (NoManager, UsageError):
        raise
    except BlockingIOError:  # its queue is full
        raise _no_answer(name) from None
    except (OSError, RunError, WireError) as error:
        is_look = isinstance(command, LookCommand)
        done = "" if is_look else "; the command may have taken effect"
        raise RunError(f"robot '{name}' gave no answer: {error}{done}") from error
    if isinstance(told, Refusal):
        raise told.to_error()
    return told


def ask(robot: str | AgentAddresses | None, command: Command, type_: type[R]) -> R:
    """Return the result of a command, which is of a type; raises as `send_command`."""
    result = send_command(robot, command)
    if not isinstance(result, type_):
        raise RunError(
            f"unexpected answer '{type(result).__name__}' of the manager: is it "
            "another version of Poise?"
        )
    return result


def _find(robot: str | AgentAddresses | None) -> Path | AgentAddresses:
    """Return a running robot's control socket, or its agents where that is not here."""
    managed = running_here()
    if isinstance(robot, AgentAddresses):
        here = noted_of(robot.robot) if robot.robot in managed else None
        is_same = here is not None and here.endpoints == robot.endpoints
        return path_of(robot.robot) if is_same else robot  # not one of the same name
    if robot is None:
        robot = _only_one(managed, [addresses.robot for addresses in noted()])
    if robot in managed:
        return path_of(robot)
    addresses = noted_of(robot)
    if addresses is None:
        raise _not_here(robot, managed)
    return addresses


def _only_one(managed: Sequence[str], noted_here: Collection[str]) -> str:
    names = {*managed, *noted_here}
    if len(names) > 1:  # a note may be older than the end of its robot
        names = {*managed, *robots_without_manager(but=managed)}
    if len(names) > 1:
        said = (n if n in managed else f"{n}, no manager here" for n in sorted(names))
        raise UsageError(
            f"several robots run ({', '.join(said)}): name one with --robot"
        )
    return next(iter(names), "")


def _not_here(robot: str, managed: Sequence[str]) -> UsageError:
    names = sorted({*managed, *robots_without_manager(but=managed)})
    which = f"robot '{robot}' does not run" if robot else "no robot runs"
    return UsageError(
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


def _told_elsewhere(addresses: AgentAddresses, command: Command) -> Response:
    """Return what a manager says that runs beside another agent, once one does."""
    keys = addresses.credentials()
    if keys is not None and keys.role == "viewer":
        raise _no_manager(addresses, f"the keys in {keys.folder} allow no commands")
    session = open_session(connect=tuple(addresses.endpoints.values()), keys=keys)
    try:
        key = _manager_key(session, addresses.robot, _REACH_LIMIT)
        if not key:
            missing = _no_manager(addresses)
            if missing.left is None:  # a standby leads soon
                key = _manager_key(session, addresses.robot, _CHANGE_LIMIT)
                missing = missing if key else _no_manager(addresses, waited=True)
            if not key:
                raise missing
        limit = STATUS_LIMIT if isinstance(command, RecordCommand) else COMMAND_LIMIT
        told = _answers(session, key, frame.pack_record(command), limit)
    finally:
        close_session(session)
    if not told:
        raise RunError("its manager has ended, or is too busy")
    return frame.unpack_record(told[key], Response)  # type: ignore[no-any-return]


def _manager_key(session: zenoh.Session, robot: str, limit: float) -> str:
    """Return where a manager takes commands; empty: nowhere within a limit [s]."""
    until = time.monotonic() + limit
    while not (
        beside := _answers(session, f"poise/{robot}/control/*", b"", _PROBE_LIMIT)
    ):
        if time.monotonic() >= until:
            return ""
        time.sleep(_ASK_EVERY)
    return next(iter(beside))


def _answers(
    session: zenoh.Session, key: str, packet: bytes, limit: float
) -> dict[str, bytes]:
    """Return the first answer of an agent that has a manager, by its key."""
    refused = ""
    for reply in session.get(key, payload=packet, timeout=limit):
        if reply.ok is None:
            refused = reply.err.payload.to_string() if reply.err else "no answer"
        elif data := reply.ok.payload.to_bytes():
            return {str(reply.ok.key_expr): data}
    if refused:
        raise RunError(refused)
    return {}


def _no_manager(
    addresses: AgentAddresses, denied: str = "", *, waited: bool = False
) -> NoManager:
    """Return what agents say; UsageError: none says that something runs.

    `denied`: why they take no command; `waited`: no standby has followed in time.
    """
    status = ask_agents(addresses)
    if status is None:
        raise _not_here(addresses.robot, running_here())
    why, agents = status.deviations[0].what, status.computers.values()
    is_over = all(each.unmanaged for each in agents) and (
        # others might have a leader
        2 * len(agents) > len(addresses.endpoints)
        if waited
        else not any(each.has_standbys for each in agents)
    )
    why += f" ({denied})" if denied else ""
    return NoManager(why, status, addresses if is_over else None)


def _wait(connection: socket.socket, path: Path, command: Command) -> None:
    """Wait for the answer to a command for as long as the manager works."""
    manager, began, patience = peer_of(connection), time.monotonic(), STATUS_LIMIT
    while not wait_readable([connection.fileno()], _LOOK_EVERY):
        waited = time.monotonic() - began
        if _is_stopped(manager):
            raise _no_answer(path.stem, manager, waited)
        if waited < patience:
            continue
        if isinstance(command, RecordCommand) or not _gives_status(path):
            raise _no_answer(path.stem, manager, waited)
        if waited >= COMMAND_LIMIT:
            raise Timeout(
                f"the manager has been busy for {COMMAND_LIMIT:g} s; its work "
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
        return bool(wait_readable([connection.fileno()], STATUS_LIMIT))


def _no_answer(robot: str, manager: int | None = None, waited: float = 0) -> NoManager:
    """Return what is known of a manager that has been silent for some time [s].

    `manager`: its process; None: it takes no more connections.
    """
    why = f"the manager of robot '{robot}' takes no more connections"
    if manager is not None:
        process = f"the manager of robot '{robot}' (process {manager})"
        why = f"{process} has not answered for {waited:.0f} s"
        if _is_stopped(manager):
            why += f": it is stopped, and `kill -CONT {manager}` lets it go on"
    why += "; `poise up --take-over FILE` replaces it"
    addresses = noted_of(robot)
    status = ask_agents(addresses, why) if addresses is not None else None
    return NoManager(status.deviations[0].what if status else why, status)


def _is_stopped(pid: int) -> bool:
    stat = process_stat(pid)
    return stat is not None and stat.is_stopped
