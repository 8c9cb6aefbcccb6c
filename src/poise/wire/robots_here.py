"""The robots of this user here: their managers' control sockets, and their agents.

A manager whose agents outlive it notes them beside its control socket, and each agent
notes all where no manager does, until the robot has stopped.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec import Struct

from poise.decoding import from_json
from poise.errors import RunError
from poise.user_folders import temporary_folder, write_private
from poise.wire.codec import MALFORMED

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials


_PEER = struct.Struct("iii")
"""Process, user and group of who listens at the other end."""


def folder() -> Path:
    """Return the folder of this user's control sockets."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "poise"
    return temporary_folder() / f"poise-{os.getuid()}"


def make_folder() -> Path:
    """Return that folder, which is there from now on."""
    made = folder()
    made.mkdir(mode=0o700, parents=True, exist_ok=True)
    if made.stat().st_uid != os.getuid():
        raise _another_users(made)
    if _held and not os.path.samestat(os.fstat(_held[0]), made.stat()):
        os.close(_held.pop())
    if not _held:
        _held.append(hold(made))
    return made


def _another_users(folder: Path) -> RunError:
    return RunError(
        f"{folder} is another user's: set XDG_RUNTIME_DIR to a folder of yours"
    )


_held: list[int] = []
"""What keeps the files in that folder, for as long as this process lives."""


def hold(folder: Path) -> int:
    """Return a descriptor that keeps the files in a folder while it is open.

    systemd removes files in /tmp after some days, but none from a folder that is locked
    (tmpfiles.d(5)).
    """
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    with contextlib.suppress(OSError):  # not every file system has locks
        fcntl.flock(held, fcntl.LOCK_SH | fcntl.LOCK_NB)
    return held


def path_of(robot: str) -> Path:
    """Return where the control socket of a robot is."""
    return folder() / f"{robot}.sock"


def running_here() -> list[str]:
    """Return the names of this user's robots whose managers run here."""
    return [p.stem for p in _files(".sock") if is_alive(p)]


def _files(ending: str) -> list[Path]:
    """Return the files of the folder; RunError: it is another user's, as after `su`.

    In /tmp anybody may have made it, and would answer in a manager's place.
    """
    try:
        is_named = os.environ.get("XDG_RUNTIME_DIR")
        if not is_named and folder().stat().st_uid != os.getuid():
            raise _another_users(folder())
        return sorted(path for path in folder().iterdir() if path.suffix == ending)
    except FileNotFoundError:
        return []
    except PermissionError as error:
        raise RunError(
            f"{folder()}: {error.strerror}: set XDG_RUNTIME_DIR to a folder of yours"
        ) from None


def former_of(path: Path) -> Path:
    """Return where a control socket is while a manager takes over that may yet fail."""
    return path.with_suffix(".former")


def is_alive(path: Path) -> bool:
    """Return at once whether a manager listens there, however many clients queue.

    One that was not taken over after all listens there again: who took over may have
    been killed before it led.
    """
    if not _listens(path) and _listens(former := former_of(path)):
        with contextlib.suppress(FileNotFoundError):  # another process was first
            former.rename(path)
    return _listens(path)


def _listens(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True


def peer_of(connection: socket.socket) -> int:
    """Return the process that listens at the other end of an AF_UNIX connection."""
    peer = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    pid: int = _PEER.unpack(peer)[0]
    return pid


class AgentAddresses(Struct, frozen=True):
    """The agents of a robot; `endpoints`: computer -> zenoh endpoint.

    `keys`: the folder of the keys that they ask for; empty: none, or a person's own.
    """

    robot: str
    endpoints: Mapping[str, str]
    keys: str = ""

    def credentials(self) -> Credentials | None:
        """Return the keys; UsageError when they are not there any more."""
        if not self.keys and not any(
            e.startswith("tls/") for e in self.endpoints.values()
        ):
            return None
        from poise.wire.credentials import Credentials, find  # noqa: PLC0415, `ssl` is slow

        if not self.keys:
            return find(self.robot, "manager", "viewer")
        return Credentials(Path(self.keys)).check(self.robot, "manager", "viewer")


def note(addresses: AgentAddresses) -> None:
    """Keep the addresses of a robot's agents, in place of earlier ones."""
    path = _path(addresses.robot)
    try:
        make_folder()
        write_private(path, msgspec.json.encode(addresses))
    except OSError as error:
        raise RunError(
            f"{path} cannot be written ({error}): if the manager is killed, `poise "
            "status` and `poise stop` find the robot by --file only"
        ) from error


def forget(robot: str) -> None:
    """Forget the agents of a stopped robot, and the socket of its killed manager."""
    _path(robot).unlink(missing_ok=True)
    if not is_alive(path_of(robot)):
        path_of(robot).unlink(missing_ok=True)


def noted_of(robot: str) -> AgentAddresses | None:
    """Return where a robot's agents are, if that is noted on this computer."""
    return next(noted(robot), None)


def noted(robot: str | None = None) -> Iterator[AgentAddresses]:
    """Yield what managers of this user noted on this computer, of one robot or all."""
    for path in _files(".agents"):
        if robot not in {None, path.stem}:
            continue
        try:
            yield from_json(path.read_bytes(), AgentAddresses)
        except FileNotFoundError:  # the robot has just stopped
            continue
        except MALFORMED as error:
            raise RunError(f"{path}: {error}: remove it") from error


def _path(robot: str) -> Path:
    return folder() / f"{robot}.agents"
