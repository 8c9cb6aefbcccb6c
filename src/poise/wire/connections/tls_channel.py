"""Frames over TLS 1.3, between containers on two computers, as `_channel` has them.

OpenSSL lets only one thread at a time into a session: so all waiting happens outside.
"""

from __future__ import annotations

import select
import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from poise.errors import Timeout, Unavailable
from poise.wire import _channel
from poise.wire.address import LOST_AFTER, peek
from poise.wire.codec import Bytes, Unreadable, WireError, codec
from poise.wire.credentials import Credentials, role_of
from poise.wire.frame import Frame, Pieces, receive_packet

_HEAD = struct.Struct("<II")
_AHEAD = 1 << 14
"""Bytes to read at once, a whole record: nearly every frame comes in one step."""
_JOINED = 1 << 14
"""Pieces up to this size share a TLS record [bytes]; no record carries more."""
_TLS_RECORDS = b"\x15\x03", b"\x16\x03"
"""How answers to a handshake begin; a frame that begins so would be longer than any
refusal."""
_LARGEST_REFUSAL = 1024
_Result = TypeVar("_Result")


_NO_TLS = "WRONG_VERSION_NUMBER"
"""How OpenSSL calls bytes that are none of TLS."""


class Handshake:
    """The beginning of a TLS session over a connected socket, which it takes over.

    Unavailable: the other end has gone already.
    """

    def __init__(
        self, plain: socket.socket, keys: Credentials, *, accepts: bool
    ) -> None:
        plain.setblocking(False)
        context = keys.server if accepts else keys.client
        try:
            plain.getpeername()  # of one that is gone `ssl` would leave its own open
            self.socket = context.wrap_socket(
                plain, server_side=accepts, do_handshake_on_connect=False
            )
        except OSError as error:
            raise Unavailable(f"no TLS session: {_reason(error)}") from error
        self._accepts = accepts
        self.event = select.POLLIN

    def go_on(self) -> bool:
        """Go on as far as that needs no wait, and return whether it is done.

        Else it waits for `event`. Unavailable: the other end refuses, or must not be
        here.
        """
        try:
            self._raise_if_refused()
            self.socket.do_handshake()
        except ssl.SSLWantReadError:
            self.event = select.POLLIN
            return False
        except ssl.SSLWantWriteError:
            self.event = select.POLLOUT
            return False
        except OSError as error:
            why = _reason(error)
            if why == _NO_TLS and not self._accepts:  # it came after the look for it
                why = "the answer is plain: no such container, or an agent without keys"
            raise Unavailable(f"no TLS session: {why}") from error
        role = role_of(self.socket.getpeercert())
        if role != "agent":
            raise Unavailable(f"the other end has a certificate of the role '{role}'")
        return True

    def finish(self, deadline: float) -> None:
        """Go on until it is done."""
        while not self.go_on():
            poll = select.poll()
            poll.register(self.socket, self.event)
            if not poll.poll(1000 * max(0.0, deadline - time.monotonic())):
                raise Timeout("the other end does not finish the handshake in time")

    def _raise_if_refused(self) -> None:
        """Raise what a gateway says, which hands connections on before any TLS."""
        if self._accepts:
            return
        start = peek(self.socket, 2)
        if start and start not in _TLS_RECORDS:
            deadline = time.monotonic() + LOST_AFTER
            refusal = receive_packet(self.socket, deadline, _LARGEST_REFUSAL)
            raise Unavailable(_channel.parse(refusal).value(codec(str)))


class TlsChannel:
    """Frames over a TLS socket whose handshake is done."""

    def __init__(self, connection: ssl.SSLSocket) -> None:
        self._socket = connection
        self._inside = threading.Lock()
        self._ahead = b""
        # it waits and asks the kernel, and reads nothing
        self._kernel = _channel.Channel(connection.fileno(), LOST_AFTER)

    def is_lost(self) -> bool:
        """Return whether the other computer was silent for too long."""
        return self._kernel.is_lost()

    def send(self, pieces: Pieces, deadline: float, largest: int) -> None:
        """Send a frame before `deadline`."""
        size = sum(map(len, pieces))
        if size > largest:
            raise WireError(f"a frame of {size} B; {largest} B is the largest")
        head = _HEAD.pack(size, 0)
        if size <= _JOINED:
            self._write(b"".join((head, *pieces)), deadline)
        else:
            for part in _joined(head, pieces):
                self._write(part, deadline)

    def receive(self, deadline: float, largest: int, _: object = None) -> Frame:
        """Return the next frame, before `deadline`."""
        while len(self._ahead) < _HEAD.size:
            self._ahead += self._some(self._socket.read, _AHEAD, deadline)
        size, block = _HEAD.unpack_from(self._ahead)
        if size > largest:
            raise Unreadable(f"a frame of {size} B; {largest} B is the largest")
        if block:
            raise Unreadable(f"a shared block {block} was announced over TLS")
        end = _HEAD.size + size
        if len(self._ahead) < end:
            return _channel.parse(self._read_rest(end, deadline))
        data, self._ahead = self._ahead[_HEAD.size : end], self._ahead[end:]
        return _channel.parse(data)

    def ask(
        self, pieces: Pieces, deadline: float, largest: int, _: object = None
    ) -> Frame | None:
        """Send a call and return its answer; None: the other end had gone before."""
        try:
            self.send(pieces, deadline, largest)
        except Unavailable:
            return None
        try:
            return self.receive(deadline, largest)
        except Timeout:
            raise Timeout("no answer came in time") from None

    def _write(self, data: Bytes, deadline: float) -> None:
        sent = self._do(self._socket.send, data, deadline)
        while sent < len(data):
            rest = memoryview(data)[sent:]
            sent += self._do(self._socket.send, rest, deadline)

    def _read_rest(self, end: int, deadline: float) -> Bytes:
        """Return a frame of which only a part is here, without what stands before."""
        target = memoryview(bytearray(end - _HEAD.size))
        start = len(self._ahead) - _HEAD.size
        target[:start], self._ahead = self._ahead[_HEAD.size :], b""
        while start < len(target):
            start += self._some(self._socket.recv_into, target[start:], deadline)
        if rest := self._socket.pending():  # of the last record; of it no poll knows
            self._ahead = self._do(self._socket.read, rest, deadline)
        return target.toreadonly()

    def _some(
        self, step: Callable[..., _Result], argument: object, deadline: float
    ) -> _Result:
        self._kernel.wait(select.POLLIN, deadline)
        got = self._do(step, argument, deadline)
        if not got:
            raise Unavailable("the other end is gone: it closed the connection")
        return got

    def _do(
        self, step: Callable[..., _Result], argument: object, deadline: float
    ) -> _Result:
        """Take a step in the session as soon as it needs no wait."""
        while True:
            try:
                with self._inside:
                    return step(argument)
            except ssl.SSLWantReadError:
                event = select.POLLIN
            except ssl.SSLWantWriteError:
                event = select.POLLOUT
            except OSError as error:
                raise Unavailable(f"the other end is gone: {_reason(error)}") from error
            self._kernel.wait(event, deadline)


def _joined(head: Bytes, pieces: Pieces) -> Iterator[Bytes]:
    """Yield the bytes of pieces, small ones together."""
    small, size = [head], len(head)
    for piece in pieces:
        if len(piece) <= _JOINED - size:
            small.append(piece)
            size += len(piece)
            continue
        yield b"".join(small)
        yield piece
        small, size = [], 0
    if small:
        yield b"".join(small)


def _reason(error: OSError) -> str:
    """Return what OpenSSL or the kernel says, without the place in their source."""
    reason = getattr(error, "reason", None) or error.strerror or str(error)
    message = getattr(error, "verify_message", "")
    return f"{reason}: {message}" if message else str(reason)
