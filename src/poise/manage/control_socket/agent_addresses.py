"""Where the agents of this user's robots are, for when their manager is gone.

A manager whose agents outlive it notes them beside its control socket. The note stays
until the robot has stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import RunError
from poise.manage.control_socket.location import folder, is_alive, make_folder, path_of


class AgentAddresses(Struct, frozen=True):
    """The agents of a robot; `endpoints`: computer -> zenoh endpoint."""

    robot: str
    endpoints: Mapping[str, str]


def note(addresses: AgentAddresses) -> None:
    """Keep the addresses of a robot's agents, in place of earlier ones.

    Raises
    ------
    RunError
        They cannot be written.
    """
    path = _path(addresses.robot)
    try:
        make_folder()
        draft = path.with_suffix(".draft")
        draft.write_bytes(msgspec.json.encode(addresses))
        draft.rename(path)
    except OSError as error:
        raise RunError(
            f"{path} cannot be written ({error}): if the manager is killed, `poise "
            "status` and `poise stop` find the robot by --file only"
        ) from error


def forget(robot: str) -> None:
    """Forget the agents of a robot that has stopped; harmless when repeated.

    The control socket of a killed manager goes, too.
    """
    _path(robot).unlink(missing_ok=True)
    if not is_alive(path_of(robot)):
        path_of(robot).unlink(missing_ok=True)


def noted() -> Iterator[AgentAddresses]:
    """Yield what managers of this user noted on this computer.

    Raises
    ------
    RunError
        Another version of Poise wrote a note.
    """
    for path in sorted(folder().glob("*.agents")):
        try:
            yield msgspec.json.decode(path.read_bytes(), type=AgentAddresses)
        except FileNotFoundError:  # the robot has just stopped
            continue
        except msgspec.MsgspecError as error:
            raise RunError(f"{path}: {error}: remove it") from error


def _path(robot: str) -> Path:
    return folder() / f"{robot}.agents"
