"""Where a running robot's control socket is: in the user's runtime folder."""

from __future__ import annotations

import os
import socket
import tempfile
from pathlib import Path

from poise.errors import RunError


def folder() -> Path:
    """Return the folder of this user's control sockets."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "poise"
    return Path(tempfile.gettempdir()) / f"poise-{os.getuid()}"


def make_folder() -> Path:
    """Return that folder, which is there from now on.

    Raises
    ------
    OSError, RunError
        It cannot be made, or is another user's.
    """
    made = folder()
    made.mkdir(mode=0o700, parents=True, exist_ok=True)
    if made.stat().st_uid != os.getuid():
        raise RunError(
            f"{made} is another user's: set XDG_RUNTIME_DIR to a folder of yours"
        )
    return made


def path_of(robot: str) -> Path:
    """Return where the control socket of a robot is."""
    return folder() / f"{robot}.sock"


def running_here() -> list[str]:
    """Return the names of this user's robots whose managers run here."""
    return [p.stem for p in sorted(folder().glob("*.sock")) if is_alive(p)]


def is_alive(path: Path) -> bool:
    """Return at once whether a manager listens there, however many clients queue."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True
