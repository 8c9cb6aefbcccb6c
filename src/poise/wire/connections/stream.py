"""Frames over a stream socket, each with its length before it."""

from __future__ import annotations

import math
import socket
import struct
import time

from poise.errors import Timeout, Unavailable
from poise.wire.codec import Bytes, WireError

_LENGTH = struct.Struct("<Q")
_MOST_PIECES = 1024
"""The kernel takes no more in one call (IOV_MAX)."""
LARGEST = 1 << 30
"""No frame is larger [bytes]; an announced one is refused."""


def set_limit(connection: socket.socket, seconds: float) -> None:
    """Let every blocking send and receive end after `seconds` [s].

    The kernel keeps the time (SO_RCVTIMEO), which spares the poll before each system
    call that Python's own socket timeouts cost.
    """
    whole = int(seconds)
    value = struct.pack("ll", whole, max(1, int((seconds - whole) * 1e6)))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, value)


def send(
    connection: socket.socket, pieces: list[Bytes], limit: float = math.inf
) -> None:
    """Send one frame, within `limit` [s] and with no pause over the socket's limit.

    Raises
    ------
    WireError
        The frame is larger than `LARGEST`; nothing was sent.
    Timeout
        The other end did not take it in time. Part of it may have been sent: the
        connection must be closed.
    Unavailable
        The other end is gone.
    """
    length = sum(memoryview(piece).nbytes for piece in pieces)
    if length > LARGEST:
        raise WireError(f"a frame of {length} B; {LARGEST} B is the largest")
    send_all(connection, [_LENGTH.pack(length), *pieces], limit)


def send_all(
    connection: socket.socket, pieces: list[Bytes], limit: float = math.inf
) -> None:
    """Send bytes, however many; raises `Timeout` and `Unavailable` as `send`."""
    deadline = time.monotonic() + limit
    left = [memoryview(piece) for piece in pieces]
    try:
        while left:
            sent = connection.sendmsg(left[:_MOST_PIECES])
            while left and sent >= left[0].nbytes:
                sent -= left.pop(0).nbytes
            if sent:
                left[0] = left[0][sent:]
            if left:
                _raise_if_past(deadline)
    except (BlockingIOError, TimeoutError):
        raise Timeout("the other end takes no more bytes") from None
    except OSError as error:
        raise Unavailable(f"the other end is gone: {error}") from error


def receive(connection: socket.socket, limit: float = math.inf) -> bytearray:
    """Return the next frame, within `limit` [s] and no pause over the socket's limit.

    Raises
    ------
    Timeout
        It did not come in time.
    Unavailable
        The other end is gone.
    WireError
        The announced length is out of range.
    """
    deadline = time.monotonic() + limit
    (length,) = _LENGTH.unpack(_exactly(connection, _LENGTH.size, deadline))
    if length > LARGEST:
        raise WireError(f"a frame of {length} B; {LARGEST} B is the largest")
    return _exactly(connection, length, deadline)


def _raise_if_past(deadline: float) -> None:
    if time.monotonic() > deadline:
        raise TimeoutError


def _exactly(connection: socket.socket, length: int, deadline: float) -> bytearray:
    data = bytearray(length)
    view = memoryview(data)
    try:
        while view:
            count = connection.recv_into(view)
            if not count:
                raise Unavailable("the other end closed the connection")
            view = view[count:]
            if view:
                _raise_if_past(deadline)
    except (BlockingIOError, TimeoutError):
        raise Timeout("nothing came from the other end") from None
    except OSError as error:
        raise Unavailable(f"the other end is gone: {error}") from error
    return data
