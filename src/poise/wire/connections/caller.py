"""The connection over which the call of a thread came."""

from __future__ import annotations

import threading

from poise.wire.connections.connection import Connection


class _ServedCall(threading.local):
    connection: Connection | None = None


_served = _ServedCall()


def serve(connection: Connection) -> None:
    """Note the connection whose calls this thread runs from now on."""
    _served.connection = connection


def connection() -> Connection | None:
    """Return the connection over which came what this thread handles."""
    return _served.connection


def is_gone() -> bool:
    """Return at once whether the caller gave up or ended; False without a caller."""
    connection = _served.connection
    return connection is not None and not connection.is_idle()
