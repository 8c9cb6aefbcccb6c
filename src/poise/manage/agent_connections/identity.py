"""Which manager this is, and whether another one has ended."""

from __future__ import annotations

import getpass
import os
import socket
import uuid
from pathlib import Path

from poise.clock import wall_time
from poise.wire.records.requests import ManagerId


def manager_id() -> ManagerId:
    """Return an identity for a manager that starts now."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # it has no name
        user = str(os.getuid())
    return ManagerId(
        key=uuid.uuid4().hex,
        user=user,
        host=socket.gethostname(),
        pid=os.getpid(),
        since=wall_time(),
    )


def has_ended(manager: ManagerId) -> bool:
    """Return whether a manager of this computer has ended; False where unknown."""
    is_here = manager.host == socket.gethostname()
    return is_here and not Path(f"/proc/{manager.pid}").exists()
