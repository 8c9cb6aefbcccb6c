"""Who waits for what a thread does: the other end of the link that brought a call."""

from __future__ import annotations

import threading

from poise.wire.connections.connection import Connection


class _Served(threading.local):
    connection: Connection | None = None


_served = _Served()


def serve(connection: Connection) -> None:
    """Know over which link the calls come that this thread runs from now on."""
    _served.connection = connection


def is_gone() -> bool:
    """Return at once whether the caller gave up, or ended; False when there is none."""
    connection = _served.connection
    return connection is not None and not connection.is_idle()
