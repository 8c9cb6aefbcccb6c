"""One frame: what crosses a connector, or a record between two programs.

::

    version u8, kind u8, tag u16, body length u32, number u64, chain u64, sent u64,
    body, padding, buffers

Little endian. `sent` is the time on the sender's monotonic clock [ns]. The buffers may
lie in shared memory. By kind, where they say something:

===============  =============================  ==============================
kind             number                         tag
===============  =============================  ==============================
MESSAGE, ONEWAY  how many went out              what it is: a checksum of name
CALL             how long the caller waits      and types of the method or the
                 [ns]; 0: no limit              message
ERROR            `connection.LAST_ANSWER`: the
                 connection ends behind it
HELLO            what the connection is for
MARKER           which marker it is
CREDIT_REQUEST   how many messages went out     whether a first answer came
CREDIT           how many may have gone out
===============  =============================  ==============================

`chain` is the call chain of a call; of messages, and of what is about their credit, it
identifies the route (`poise.runtime.connectors.flow_control`).
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from enum import IntEnum
from typing import Any

from msgspec import Struct

from poise.errors import Timeout, Unavailable, encodable
from poise.wire import _channel
from poise.wire.codec import Bytes, Codec, Unreadable, codec

VERSION = 2
LARGEST = 1 << 30
"""No frame on any socket is larger [bytes]; a larger one is refused."""
_HEAD = 32
"""The size of the head [bytes]."""
_INLINE = 2
"""Head and body; padding and buffers follow."""
LENGTH = struct.Struct("<II")
"""What stands before each frame on a stream: its length and block (`connection`)."""
RECORD_LIMIT = 1.0
"""A record is sent within this time, and received within it once it begins [s]."""
_PIECE = 1 << 20
_MOST_WAITING = 1 << 26
"""No more is added to what waits for a receiver once it is over this [bytes]."""


class FrameKind(IntEnum):
    """The kinds of frames."""

    MESSAGE = 1
    CALL = 2
    ONEWAY = 3
    RESULT = 4
    ERROR = 5
    HELLO = 6
    MOVED = 7
    MARKER = 8
    CREDIT_REQUEST = 9
    CREDIT = 10
    RECORD = 11


Pieces = list[Bytes]
"""A frame as it is sent, one piece after the other."""

segments = _channel.segments
"""Return the pieces of a frame; the buffers of its value are not copied."""

parse = _channel.parse
"""Return the frame in bytes; its buffers lie behind the body, or are given.

WireError when the bytes are cut short, or from a protocol version that is not ours.
"""

FAILURE: Codec[tuple[str, str, str]] = Codec(tuple[str, str, str])
"""The body of an ERROR: type, message and traceback."""


class Frame(Struct, frozen=True):
    """A received frame; nothing else writes to its body and its buffers."""

    kind: FrameKind
    tag: int
    number: int
    chain: int
    body: Bytes
    buffers: memoryview
    size: int  # As `size_of` returned it where it was sent [bytes]
    # The time when it was parsed, less the time when it was sent [s], each on its own
    # computer's clock
    age: float
    came: float  # When it was parsed [s, on this computer's monotonic clock]

    def value(self, codec: Codec[Any]) -> Any:  # noqa: ANN401, what the codec decodes
        """Return the decoded value; WireError when it is not of the codec's type."""
        return codec.decode(self.body, self.buffers)


def failure(
    type_name: str, message: str, traceback: str = "", number: int = 0
) -> Pieces:
    """Return the answer to a call that failed; a callee's error has a traceback."""
    body = encodable(type_name), encodable(message), encodable(traceback)
    return segments(FAILURE, body, FrameKind.ERROR, number=number)


def size_of(pieces: Pieces) -> int:
    """Return the size of a frame [bytes], without padding."""
    if len(pieces) == _INLINE:
        return _HEAD + len(pieces[1])
    return sum(map(len, pieces)) - len(pieces[_INLINE])


def send_record(connection: socket.socket, record: Struct) -> None:
    """Send a record within `RECORD_LIMIT`; after Timeout close the connection."""
    RecordWriter(connection).send(record)


def send_packet(connection: socket.socket, packet: Bytes) -> None:
    """Send what `pack_record` returned over a stream, within `RECORD_LIMIT`."""
    RecordWriter(connection).send_packet(packet)


def receive_record(connection: socket.socket, type_: Any) -> Any:  # noqa: ANN401, as `Codec`
    """Return the next record of `type_` from a stream socket, within `RECORD_LIMIT`."""
    return unpack_record(receive_packet(connection), type_)


def receive_packet(
    connection: socket.socket, deadline: float | None = None, largest: int = LARGEST
) -> bytes:
    """Return the next frame, by `RECORD_LIMIT` from now, and read nothing behind it.

    `deadline`: by this moment [s] instead; `largest`: a larger frame is refused.
    """
    reader = RecordReader(connection, largest)
    until = time.monotonic() + RECORD_LIMIT if deadline is None else deadline
    while (packet := reader.next_packet()) is None:
        _wait(connection, select.POLLIN, until, "sent no whole frame in time")
    return packet


class RecordReader:
    """Reads records from a stream socket as they come; never waits for the rest."""

    def __init__(self, connection: socket.socket, largest: int = LARGEST) -> None:
        self._connection = connection
        self._largest = largest
        self._data = bytearray()

    def next(self, type_: Any) -> Any:  # noqa: ANN401, as `Codec`
        """Return the next record, or None when not all of it has come yet."""
        packet = self.next_packet()
        return None if packet is None else unpack_record(packet, type_)

    def next_packet(self) -> bytes | None:
        """Return the next record as a packet, or None when not all of it has come."""
        while missing := self._missing():
            try:
                # not `ssl`'s: a refusal comes before the handshake
                data = socket.socket.recv(
                    self._connection, min(missing, _PIECE), socket.MSG_DONTWAIT
                )
            except BlockingIOError:
                return None
            except OSError as error:
                raise Unavailable(f"the other end is gone: {error}") from error
            if not data:
                raise Unavailable("the other end is gone")
            self._data += data
        packet = bytes(self._data[LENGTH.size :])
        self._data.clear()
        return packet

    def _missing(self) -> int:
        if len(self._data) < LENGTH.size:
            return LENGTH.size - len(self._data)
        length, block = LENGTH.unpack_from(self._data)
        _check_size(length, self._largest)
        if block:
            raise Unreadable("a frame with shared memory, which is not for this socket")
        return int(LENGTH.size + length - len(self._data))


class RecordWriter:
    """Sends records over a stream socket; one cut short goes on with the next."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._rest = memoryview(b"")

    def send(self, record: Struct) -> None:
        """Send a record; after a Timeout, what is left of it goes before the next."""
        self.send_packet(pack_record(record))

    def send_packet(self, packet: Bytes) -> None:
        """Send a record that is a packet already; as `send`."""
        data, deadline = _with_length(packet), time.monotonic() + RECORD_LIMIT
        self._flush(deadline)
        self._rest = memoryview(data)
        self._flush(deadline)

    def push(self, record: Struct) -> None:
        """Send what there is room for of a record; `flush` sends the rest.

        Timeout: over `_MOST_WAITING` of earlier records have not been taken.
        """
        if (waiting := len(self._rest)) > _MOST_WAITING:
            raise Timeout(f"the other end has left {waiting} B unread")
        self._rest = memoryview(bytes(self._rest) + _with_length(pack_record(record)))
        self.flush()

    def flush(self) -> None:
        """Send more of what waits, as far as there is room."""
        with contextlib.suppress(Timeout):
            self._flush(time.monotonic())

    @property
    def is_waiting(self) -> bool:
        """Whether something is left for `flush`."""
        return bool(self._rest)

    def _flush(self, deadline: float) -> None:
        flags = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL
        late = f"took no record within {RECORD_LIMIT:g} s"
        while self._rest:
            try:
                self._rest = self._rest[self._connection.send(self._rest, flags) :]
            except BlockingIOError:
                _wait(self._connection, select.POLLOUT, deadline, late)
            except OSError as error:
                raise Unavailable(f"the other end is gone: {error}") from error


def pack_record(record: Struct) -> bytes:
    """Return a record as one packet, for sockets that keep the borders of packets."""
    return b"".join(segments(codec(type(record)), record, FrameKind.RECORD))


def unpack_record(packet: Bytes, type_: Any) -> Any:  # noqa: ANN401, as `Codec`
    """Return the record in a packet; WireError when it is not one of `type_`."""
    received = parse(packet)
    if received.kind is not FrameKind.RECORD:
        raise Unreadable(f"a frame of the kind {received.kind.name}, not a record")
    return received.value(codec(type_))


def _wait(connection: socket.socket, event: int, deadline: float, late: str) -> None:
    """Wait until a socket is ready; Timeout at a moment [s]."""
    poll = select.poll()
    poll.register(connection, event)
    if not poll.poll(1e3 * max(0.0, deadline - time.monotonic())):
        raise Timeout(f"the other end {late}")


def _with_length(packet: Bytes) -> bytes:
    _check_size(len(packet), LARGEST)
    return LENGTH.pack(len(packet), 0) + packet


def _check_size(size: int, largest: int) -> None:
    if size > largest:
        raise Unreadable(f"a frame of {size} B; {largest} B is the largest")
