"""Records over a stream socket, between an agent, its zygote and its containers."""

from __future__ import annotations

import socket
from typing import TypeVar

from msgspec import Struct

from poise.wire.codec import codec
from poise.wire.connections import stream

S = TypeVar("S", bound=Struct)

LIMIT = 1.0
"""A record is sent within this time, and there so long after it began to come [s]."""


def pair() -> tuple[socket.socket, socket.socket]:
    """Return two connected sockets whose sends and receives have a limit."""
    ends = socket.socketpair()
    for end in ends:
        stream.set_limit(end, LIMIT)
    return ends


def send(connection: socket.socket, record: Struct) -> None:
    """Send a record; `poise.wire.connections.stream.send` says what it raises."""
    body, _ = codec(type(record)).encode(record)
    stream.send(connection, [body], LIMIT)


def receive(connection: socket.socket, type_: type[S]) -> S:
    """Return the next record.

    Raises
    ------
    Timeout, Unavailable, WireError
        As `receive`; also when it is not a record of `type_`.
    """
    record: S = codec(type_).decode(stream.receive(connection, LIMIT), memoryview(b""))
    return record
