"""One connection between two containers: over AF_UNIX on one computer, else over TCP.

::

    length u32, block u32, [used u64 when block is not 0,] inline bytes

Little endian. The inline bytes are a frame. When `block` is not 0, its buffers are the
first `used` bytes of a block of shared memory (`blocks`): the lowest 8 bits are the
block's number, the next 16 bits its slot for this connection, and the highest bit says
that the block is new here and its file comes with the frame. Over TCP there are no
blocks: all buffers come inline. Records have this framing, too
(`poise.wire.frame`).

Native code (`poise.wire._channel`) sends and receives, without Python's lock.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import socket
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakValueDictionary

from poise import threads
from poise.errors import Timeout, Unavailable
from poise.wire import _channel
from poise.wire.address import LOST_AFTER, keep_private, peek
from poise.wire.codec import Unreadable, WireError
from poise.wire.connections.blocks import BLOCKS, THRESHOLD, Block, lender
from poise.wire.frame import LARGEST, Frame, Pieces

if TYPE_CHECKING:
    import ssl

    from poise.wire.credentials import Credentials

_NEW = 1 << 31
_NUMBER, _SLOT = (1 << 8) - 1, (1 << 16) - 1
_SLOT_AT = 8
"""The bits of `block`."""
LAST_ANSWER = 1
"""The number in an answer behind which the connection is closed; others have none."""
_LOST = {errno.ETIMEDOUT, errno.EHOSTUNREACH, errno.ENETUNREACH}
_LAST_DATA = slice(52, 56)
"""In the kernel's `tcp_info`: how long ago the last data came [ms]."""
_INLINE = 2
"""The first pieces of a frame are its head and body; padding and buffers follow."""
_ALONE = _INLINE + 3
"""The pieces of a frame with one array: it has padding before and behind."""


class _Placed(NamedTuple):
    """A frame whose arrays go over a block, which is lent to the other end."""

    block: Block
    pieces: Pieces
    where: tuple[int, int, memoryview | None, int]


class Connection:
    """Sends and receives frames; one thread at a time in each direction.

    Deadlines are moments of the monotonic clock [s]. After `Timeout` in `send` and
    after `Unreadable` the connection must be closed, for a part of a frame may have
    crossed.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        keep_private(connection)
        self.is_local = connection.family == socket.AF_UNIX
        self._channel = _channel.Channel(connection.fileno(), LOST_AFTER)
        self.is_lost = self.is_over = False
        self._reader: threading.Thread | None = None
        self._closing = threading.Lock()
        self._lenders: dict[int, _channel.Lender] = {}
        self._slot: int | None = None
        self._known: WeakValueDictionary[int, Block] = WeakValueDictionary()

    @property
    def has_blocks(self) -> bool:
        """Whether either end has shared memory for it."""
        return bool(self._lenders or self._known)

    def is_idle(self) -> bool:
        """Return at once whether the other end is there, and said nothing."""
        try:
            data = peek(self._connection, 1)
        except OSError as error:
            self.is_lost = error.errno in _LOST
            return False
        if data is not None:
            return bool(data) and self._reader is not None
        self.is_lost = self._channel.is_lost()
        return not self.is_lost

    def peer(self) -> str:
        """Return the other end's computer by its IP; empty: it is this one, or gone."""
        with contextlib.suppress(OSError):
            return "" if self.is_local else str(self._connection.getpeername()[0])
        return ""

    def is_drained(self, silence: float) -> bool:
        """Return whether all that came is read, and nothing came for `silence` [s]."""
        with contextlib.suppress(OSError):  # it is none of TCP, or closed
            if peek(self._connection, 1) is not None:
                return False
            info = self._connection.getsockopt(
                socket.IPPROTO_TCP, socket.TCP_INFO, _LAST_DATA.stop
            )
            return int.from_bytes(info[_LAST_DATA], sys.byteorder) >= 1e3 * silence
        return True

    def accept_tls(self, keys: Credentials, deadline: float) -> None:
        """Go on over TLS, which the other end begins."""
        from poise.wire.connections.tls_channel import Handshake  # noqa: PLC0415, slow

        handshake = Handshake(self._connection, keys, accepts=True)
        self._connection = handshake.socket  # `end` reaches it already
        handshake.finish(deadline)
        self.secure(handshake.socket)

    def secure(self, connection: ssl.SSLSocket) -> None:
        """Go on over a TLS session, which has taken the socket over."""
        self._connection = connection
        keep_private(connection)
        from poise.wire.connections.tls_channel import TlsChannel  # noqa: PLC0415, slow

        # the same, without shared memory
        self._channel = TlsChannel(connection)  # type: ignore[assignment]

    def close(self) -> None:
        """Close the connection; arrays that were received stay as they are."""
        if self._reader is not None:
            self.end()
            self._reader.join(LOST_AFTER)
        with self._closing:
            self._connection.close()
        self._lenders.clear()
        slot, self._slot = self._slot, None
        if slot is not None:
            BLOCKS.free_slot(slot)

    def end(self, how: int = socket.SHUT_RDWR) -> None:
        """Let its user find it closed; from any thread."""
        with contextlib.suppress(OSError):
            # not the TLS socket's, which would send plain bytes from then on
            socket.socket.shutdown(self._connection, how)

    def follow(self, handle: Callable[[Frame], bool]) -> None:
        """Let a thread take what comes back, until `handle` returns False."""
        self._reader = threads.daemon(self._follow, "credit", handle)
        try:
            self._reader.start()
        except RuntimeError as error:
            self._reader = None
            raise Unavailable(str(error)) from error

    def send_back(self, pieces: Pieces) -> bool:
        """Send a frame, from any thread, if the other end takes it at once."""
        with self._closing:
            if self._connection.fileno() < 0:
                return False
            try:
                self._channel.send(pieces, 0.0, LARGEST)
            except Unavailable:
                return False
            except Timeout:
                self.end(socket.SHUT_WR)
                return False
        return True

    def send(self, pieces: Pieces, deadline: float = math.inf) -> None:
        """Send a frame."""
        placed = self._place(pieces) if len(pieces) > _INLINE else None
        if placed is None:
            self._channel.send(pieces, deadline, LARGEST)
            return
        try:
            self._channel.send(placed.pieces, deadline, LARGEST, *placed.where)
        except BaseException:
            # also when a signal's handler raises: else the block were lost for good
            self._free_slot(placed)
            raise
        self._known[placed.block.number] = placed.block

    def ask(self, pieces: Pieces, deadline: float) -> Frame | None:
        """Send a call and return its answer; None: the other end had gone before."""
        placed = self._place(pieces) if len(pieces) > _INLINE else None
        ask, lenders = self._channel.ask, self._lenders
        if placed is None:
            got = ask(pieces, deadline, LARGEST, lenders)
        else:
            # after an error it is not taken back: the other end may read it
            got = ask(placed.pieces, deadline, LARGEST, lenders, *placed.where)
            if got is None:
                self._free_slot(placed)
            else:
                self._known[placed.block.number] = placed.block
        if isinstance(got, tuple):
            return self._on_new_block(*got, deadline)
        return got

    def receive(self, deadline: float = math.inf) -> Frame:
        """Return the next frame."""
        got = self._channel.receive(deadline, LARGEST, self._lenders)
        if isinstance(got, tuple):
            return self._on_new_block(*got, deadline)
        return got

    def _follow(self, handle: Callable[[Frame], bool]) -> None:
        try:
            while handle(self.receive()):
                pass
        except (Unavailable, Timeout, WireError):
            self.is_over = True
        except BaseException:  # nothing that comes back would be taken any more
            self.is_over = True
            raise

    def _place(self, pieces: Pieces) -> _Placed | None:
        """Lend the other end a block for the arrays; None when they go inline."""
        size = sum(map(len, pieces[_INLINE + 1 :]))
        if size > LARGEST:
            raise WireError(f"arrays of {size} B; {LARGEST} B is the largest")
        if size < THRESHOLD or not self.is_local:
            return None
        if self._slot is None:
            self._slot = BLOCKS.allocate_slot()
        slot = self._slot
        if slot is None:
            return None
        target = None
        block = BLOCKS.find(pieces[_INLINE + 1]) if len(pieces) == _ALONE else None
        # a loan that the other end has, has one slot to be given back
        if block is not None and not block.is_lent(slot):
            block.lend(slot)
            size = len(pieces[_INLINE + 1])
            pieces = pieces[:_INLINE]
        elif block := BLOCKS.allocate(size, slot):
            target = block.memory
        else:
            return None
        number, file = slot << _SLOT_AT | block.number, -1
        if self._known.get(block.number) is not block:
            number, file = number | _NEW, block.file
        return _Placed(block, pieces, (number, size, target, file))

    def _free_slot(self, placed: _Placed) -> None:
        """Undo `_place`: the other end has not got the frame."""
        if self._slot is not None:
            placed.block.release(self._slot)

    def _on_new_block(
        self, block: int, used: int, data: bytes, deadline: float
    ) -> Frame:
        """Return the frame in `data`, the first one with a block that is new here."""
        number, slot = block & _NUMBER, block >> _SLOT_AT & _SLOT
        if not self.is_local:
            raise Unreadable(f"a shared block {number} was announced over TCP")
        if not block & _NEW:
            raise Unreadable(f"there is no shared block {number}")
        file = self._channel.take_file()
        if file < 0:
            raise Unreadable(f"no file came for a shared block {number}")
        try:
            self._lenders[number] = lender(file, slot)
        except (OSError, ValueError) as error:
            raise Unreadable(f"a shared block cannot be mapped: {error}") from error
        finally:
            os.close(file)
        arrays = self._channel.lend(self._lenders[number], used, deadline)
        return _channel.parse(data, arrays)


class _Served(threading.local):
    connection: Connection | None = None


_served = _Served()


def note_served(connection: Connection) -> None:
    """Note the connection whose calls this thread runs from now on."""
    _served.connection = connection


def current_connection() -> Connection | None:
    """Return the connection whose frame this thread handles; None: it handles none."""
    return _served.connection


def is_gone() -> bool:
    """Return at once whether the caller gave up or ended; False without a caller."""
    connection = _served.connection
    return connection is not None and not connection.is_idle()
