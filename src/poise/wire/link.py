"""One connection between two containers of a computer.

::

    length u32, block u32, [used u64 when block is not 0,] inline bytes

Little endian. The inline bytes are a frame. When `block` is not 0, its buffers are the
first `used` bytes of that block of shared memory; a length of `_NEW` announces a block
of `used` bytes: the receiver answers with one byte, and the file descriptor follows.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import struct
import time

from poise.errors import Timeout, Unavailable
from poise.wire import frame, stream
from poise.wire.codec import Bytes, WireError
from poise.wire.frame import Frame
from poise.wire.pipe import Pieces
from poise.wire.shared import MOST_BLOCKS, MOST_BYTES, THRESHOLD, Block, Lender, Pool
from poise.wire.stream import LARGEST

_HEAD = struct.Struct("<II")
_USED = struct.Struct("<Q")
_NEW = 0xFFFFFFFF
_READY = b"+"
_AHEAD = 1 << 13
"""So many bytes are asked for at once: nearly every frame comes in one system call."""
_INLINE = 2
"""The first pieces of a frame are its head and body; padding and buffers follow."""


class Link:
    """Sends and receives frames; one thread at a time in each direction."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._limit = -1.0
        self._ahead = memoryview(bytearray(_AHEAD))
        self._start = self._end = 0
        self._deadline = math.inf
        self._pool = Pool()
        self._lenders: dict[int, Lender] = {}

    def set_limit(self, seconds: float) -> None:
        """Let every send and receive end after `seconds` [s]."""
        if seconds != self._limit:
            stream.set_limit(self._connection, seconds)
            self._limit = seconds

    def receive_without_limit(self) -> None:
        """Take idle for normal; a peer that ends is seen as end of file."""
        self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, bytes(16))

    def is_idle(self) -> bool:
        """Return at once whether the other end is there and has said nothing."""
        try:
            self._connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def close(self) -> None:
        """Close the connection; arrays that were received stay as they are."""
        self._connection.close()
        self._pool.close()
        self._lenders.clear()

    def end(self) -> None:
        """Let whoever uses it find it closed; from any thread."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def send(self, pieces: Pieces, limit: float = math.inf) -> None:
        """Send a frame, within `limit` [s] and with no pause over the link's own.

        Raises
        ------
        WireError
            The frame is larger than `LARGEST`; nothing was sent.
        Timeout
            The other end did not take it in time. Part of it may have been sent: the
            link must be closed.
        Unavailable
            The other end is gone, and has not got the frame.
        """
        self._deadline = time.monotonic() + limit
        if len(pieces) > _INLINE:
            self._send_buffers(pieces)
            return
        inline = b"".join(pieces)
        if len(inline) > LARGEST:
            raise WireError(f"a frame of {len(inline)} B; {LARGEST} B is the largest")
        self._write([_HEAD.pack(len(inline), 0) + inline])

    def receive(self, limit: float = math.inf) -> Frame:
        """Return the next frame, within `limit` [s] and no pause over the link's own.

        Raises
        ------
        Timeout
            It did not come in time.
        Unavailable
            The other end is gone.
        WireError
            What came is no frame; the link must be closed.
        """
        self._deadline = time.monotonic() + limit
        while True:
            self._fetch(_HEAD.size)
            length, number = _HEAD.unpack_from(self._ahead, self._start)
            self._start += _HEAD.size
            used = self._used() if number else 0
            if length <= LARGEST:
                buffers = self._lender(number).lend(used) if number else None
                return frame.parse(self._take(length), buffers)
            if length != _NEW:
                raise WireError(f"a frame of {length} B; {LARGEST} B is the largest")
            self._accept(number, used)

    def _used(self) -> int:
        self._fetch(_USED.size)
        (used,) = _USED.unpack_from(self._ahead, self._start)
        self._start += _USED.size
        return int(used)

    def _write(self, pieces: list[Bytes]) -> None:
        left = self._deadline - time.monotonic()
        stream.send_all(self._connection, pieces, left)

    def _send_buffers(self, pieces: Pieces) -> None:
        inline, buffers = b"".join(pieces[:_INLINE]), pieces[_INLINE + 1 :]
        size = sum(len(buffer) for buffer in buffers)
        if size > LARGEST:
            raise WireError(f"arrays of {size} B; {LARGEST} B is the largest")
        block = self._block(size) if size >= THRESHOLD else None
        if block is None:
            length = sum(len(piece) for piece in pieces)
            self._write([_HEAD.pack(length, 0), *pieces])
            return
        block.fill(buffers)
        try:
            head = _HEAD.pack(len(inline), block.number) + _USED.pack(size)
            self._write([head + inline])
        except BaseException:
            block.take_back()
            raise

    def _block(self, size: int) -> Block | None:
        block, is_new = self._pool.take(size)
        if block is not None and is_new:
            self._introduce(block)
        return block

    def _introduce(self, block: Block) -> None:
        head = _HEAD.pack(_NEW, block.number) + _USED.pack(block.capacity)
        self._write([head])
        self._fetch(1)
        if self._take(1) != _READY:
            raise Unavailable("the other end takes no shared memory")
        try:
            socket.send_fds(self._connection, [_READY], [block.file])
        except OSError as error:
            raise Unavailable(f"the other end is gone: {error}") from error

    def _accept(self, number: int, capacity: int) -> None:
        """Map a block that the other end announced."""
        if not (0 < number <= MOST_BLOCKS and 0 < capacity <= MOST_BYTES):
            raise WireError(f"a shared block {number} of {capacity} B was announced")
        self._write([_READY])
        try:
            _, files, _, _ = socket.recv_fds(self._connection, 1, 1)
        except OSError as error:
            raise Unavailable(f"the other end is gone: {error}") from error
        if not files:
            raise WireError("a shared block was announced, and no file came")
        try:
            self._lenders[number] = Lender(files[0], capacity)
        except (OSError, ValueError) as error:
            raise WireError(f"a shared block cannot be mapped: {error}") from error
        finally:
            os.close(files[0])

    def _lender(self, number: int) -> Lender:
        try:
            return self._lenders[number]
        except KeyError:
            raise WireError(f"there is no shared block {number}") from None

    def _fetch(self, count: int) -> None:
        """Have at least `count` bytes, of at most `_AHEAD`, ready in `_ahead`."""
        have = self._end - self._start
        if have >= count:
            return
        if not have:
            self._start = self._end = 0
        elif self._start:
            self._ahead[:have] = self._ahead[self._start : self._end]
            self._start, self._end = 0, have
        while True:
            self._end += self._read(self._ahead[self._end :])
            if self._end >= count:
                return
            self._raise_if_past()

    def _take(self, count: int) -> bytes | bytearray:
        """Return the next `count` bytes, which nothing else refers to."""
        start, end = self._start, self._start + count
        if end <= self._end:
            self._start = end
            return bytes(self._ahead[start:end])
        data = bytearray(count)
        ready = self._end - start
        self._start = self._end
        with memoryview(data) as view:
            view[:ready] = self._ahead[start : self._end]
            while ready < count:
                ready += self._read(view[ready:])
                self._raise_if_past()
        return data

    def _raise_if_past(self) -> None:
        if time.monotonic() > self._deadline:
            raise Timeout("a frame did not come in time")

    def _read(self, target: memoryview) -> int:
        try:
            count = self._connection.recv_into(target)
        except (BlockingIOError, TimeoutError):
            raise Timeout("nothing came from the other end") from None
        except OSError as error:
            raise Unavailable(f"the other end is gone: {error}") from error
        if not count:
            raise Unavailable("the other end closed the connection")
        return count
