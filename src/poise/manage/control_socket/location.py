"""Where a running robot's control socket is: in the user's runtime folder."""

from __future__ import annotations

import os
import socket
import tempfile
from pathlib import Path

from poise.errors import UsageError


def folder() -> Path:
    """Return the folder of this user's control sockets."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "poise"
    return Path(tempfile.gettempdir()) / f"poise-{os.getuid()}"


def path_of(robot: str) -> Path:
    """Return where the control socket of a robot is."""
    return folder() / f"{robot}.sock"


def find(robot: str | None) -> Path:
    """Return the control socket of a running robot; None: of the only one.

    Raises
    ------
    UsageError
        No such robot runs, or several do and none is named.
    """
    running = {name: path_of(name) for name in running_here()}
    if robot is None and len(running) == 1:
        return next(iter(running.values()))
    if robot in running:
        return running[robot]
    names = ", ".join(running) or "none"
    if robot is None and running:
        raise UsageError(f"several robots run ({names}): name one with --robot")
    which = f"robot '{robot}' does not run" if robot else "no robot runs"
    raise UsageError(
        f"{which} here (running: {names}); `poise up FILE` starts one, and `poise stop "
        "--file FILE` ends what a killed manager left on real computers"
    )


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
