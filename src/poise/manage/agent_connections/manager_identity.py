"""Who a manager is, whether it has ended, and which of several gives way."""

from __future__ import annotations

import getpass
import os
import socket
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path

from poise.clock import wall_time
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import AgentStatus


def manager_id(control: str = "") -> ManagerId:
    """Return an identity for a manager that starts now, with its control socket."""
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
        control=control,
    )


def has_ended(manager: ManagerId) -> bool:
    """Return whether a manager of this computer has ended; False where unknown."""
    is_here = manager.host == socket.gethostname()
    return is_here and not Path(f"/proc/{manager.pid}").exists()


def gives_way_to(
    manager: ManagerId,
    claimed: Mapping[str, int],
    told: Mapping[str, int],
    statuses: Iterable[AgentStatus],
) -> ManagerId | None:
    """Return the manager to which this one gives way; None: there is none.

    It is a later one that an agent obeys, or one that all agents obey which this one
    has claimed. So of two managers one gives way, whatever each of them sees. Also when
    the other is gone, if it told an agent of this one what should run: this one does
    not know what it moved, and would undo it.

    `told`: computer -> the last generation that this one told its agent.
    """
    others = {
        status.computer: status.manager
        for status in statuses
        if status.manager is not None
        and status.manager.key != manager.key
        and (
            not status.unmanaged
            or status.generation > told.get(status.computer, status.generation)
        )
        and status.token > claimed.get(status.computer, -1)
    }
    last = max(others.values(), key=lambda other: other.rank, default=None)
    has_lost_all = bool(claimed) and claimed.keys() <= others.keys()
    is_later = last is not None and last.rank > manager.rank
    return last if is_later or has_lost_all else None
