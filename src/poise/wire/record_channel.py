"""Records between two programs of one computer: frames over a stream socket."""

from __future__ import annotations

import socket
import time
from typing import Any

from msgspec import Struct

from poise.errors import Unavailable
from poise.wire import _channel, frame
from poise.wire.address import LOST_AFTER
from poise.wire.codec import Bytes, Unreadable, codec
from poise.wire.connections.connection import HEAD
from poise.wire.frame import LARGEST, Frame, Kind

LIMIT = 1.0
"""A record is sent within this time, and received within it once it begins [s]."""
_PIECE = 1 << 20


def send(connection: socket.socket, record: Struct) -> None:
    """Send a record over a stream socket, within `LIMIT`; after Timeout close it."""
    _channel_of(connection).send(_pieces(record), time.monotonic() + LIMIT, LARGEST)


def receive(connection: socket.socket, type_: Any) -> Any:  # noqa: ANN401, as `unpack`
    """Return the next record of `type_` from a stream socket, within `LIMIT`."""
    return _record(receive_frame(connection, time.monotonic() + LIMIT), type_)


def receive_frame(
    connection: socket.socket, deadline: float, largest: int = LARGEST
) -> Frame:
    """Return the next frame until `deadline` [s], and read nothing behind it."""
    received = _channel_of(connection).receive(deadline, largest, {})
    if not isinstance(received, Frame):
        raise Unreadable("a frame with shared memory, which is not for this socket")
    return received


class RecordReader:
    """Reads records from a stream socket as they come; never waits for the rest."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._data = bytearray()

    def next(self, type_: Any) -> Any:  # noqa: ANN401, as `unpack`
        """Return the next record, or None when not all of it has come yet."""
        while missing := self._missing():
            try:
                data = self._connection.recv(min(missing, _PIECE), socket.MSG_DONTWAIT)
            except BlockingIOError:
                return None
            except OSError as error:
                raise Unavailable(f"the other end is gone: {error}") from error
            if not data:
                raise Unavailable("the other end is gone")
            self._data += data
        data = bytes(self._data[HEAD.size :])
        self._data.clear()
        return unpack(data, type_)

    def _missing(self) -> int:
        if len(self._data) < HEAD.size:
            return HEAD.size - len(self._data)
        length, block = HEAD.unpack_from(self._data)
        if length > LARGEST or block:
            raise Unreadable(f"a frame of {length} B; {LARGEST} B is the largest")
        return int(HEAD.size + length - len(self._data))


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
