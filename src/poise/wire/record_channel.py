"""Records between two programs of one computer, over a socket.

Each record is the body of a frame, and the framing is that of all stream sockets
(`poise.wire.connections.connection`). The control socket of a container, the zygote's
and the control server's speak this way.
"""

from __future__ import annotations

import socket
import time
from typing import Any, TypeVar

from msgspec import Struct

from poise.wire import _channel, frame
from poise.wire.address import LOST_AFTER
from poise.wire.codec import Bytes, Unreadable, codec
from poise.wire.frame import LARGEST, Frame, Kind

S = TypeVar("S", bound=Struct)

LIMIT = 1.0
"""A record is sent within this time, and received within it once it begins [s]."""


def send(connection: socket.socket, record: Struct) -> None:
    """Send a record over a stream socket.

    Raises
    ------
    WireError
        The record is too large; nothing was sent.
    Timeout
        The other end did not take it within `LIMIT`. Part of it may have been sent: the
        connection must be closed.
    Unavailable
        The other end is gone.
    """
    _channel_of(connection).send(_pieces(record), time.monotonic() + LIMIT, LARGEST)


def receive(connection: socket.socket, type_: type[S]) -> S:
    """Return the next record from a stream socket.

    Raises
    ------
    Timeout
        Not all of it came within `LIMIT`; the connection must be closed.
    Unavailable
        The other end is gone.
    WireError
        It is not a record of `type_`.
    """
    deadline = time.monotonic() + LIMIT
    received = _channel_of(connection).receive(deadline, LARGEST, {})
    if not isinstance(received, Frame):
        raise Unreadable("a record never comes in shared memory")
    record: S = _record(received, type_)
    return record


def pack(record: Struct) -> bytes:
    """Return a record as one packet, for sockets that keep the borders of packets."""
    return b"".join(_pieces(record))


def unpack(packet: Bytes, type_: Any) -> Any:  # noqa: ANN401, a record's type, or a union
    """Return the record in a packet; WireError when it is not one of `type_`."""
    return _record(frame.parse(packet), type_)


def _channel_of(connection: socket.socket) -> _channel.Channel:
    # made for one record: it must leave the next one where `poll` sees it
    return _channel.Channel(connection.fileno(), LOST_AFTER, reads_ahead=False)


def _pieces(record: Struct) -> list[Bytes]:
    return frame.segments(codec(type(record)), record, Kind.RECORD)


def _record(received: Frame, type_: Any) -> Any:  # noqa: ANN401, as `unpack`
    if received.kind is not Kind.RECORD:
        raise Unreadable(f"a frame of the kind {received.kind.name}, not a record")
    return received.value(codec(type_))
