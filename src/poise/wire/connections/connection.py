"""One connection between two containers: over AF_UNIX on one computer, else over TCP.

::

    length u32, block u32, [used u64 when block is not 0,] inline bytes

Little endian. The inline bytes are a frame. When `block` is not 0, its buffers are the
first `used` bytes of that block of shared memory. With the bit `_NEW`, no frame but a
block of `used` bytes is announced, and the inline bytes are its slot (`loans`): the
receiver answers with one byte, and the file descriptor follows. Over TCP there are no
blocks: all buffers come inline. Records have this framing, too
(`poise.wire.record_channel`).

Native code (`poise.wire._channel`) sends and receives, without Python's lock.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from weakref import WeakValueDictionary

from poise.errors import Timeout, Unavailable
from poise.wire import _channel
from poise.wire.address import LOST_AFTER
from poise.wire.codec import Unreadable, WireError
from poise.wire.connections.channel import Pieces
from poise.wire.connections.fork import keep_private
from poise.wire.connections.loans import LOANS, LoanBlock
from poise.wire.connections.shared_memory import (
    DATA,
    MOST_BLOCKS,
    MOST_BYTES,
    THRESHOLD,
    Block,
    Pool,
    lender,
)
from poise.wire.frame import LARGEST, Frame

_NEW = 1 << 31
_READY = b"+"
HEAD = struct.Struct("<II")
"""The head before each frame: its length and block."""
LAST_ANSWER = 1
"""The number in an answer behind which the connection is closed; others have none."""
_LOST = {errno.ETIMEDOUT, errno.EHOSTUNREACH, errno.ENETUNREACH}
_INLINE = 2
"""The first pieces of a frame are its head and body; padding and buffers follow."""
_ALONE = _INLINE + 3
"""The pieces of a frame with one array: it has padding before and behind."""
_MOST_NUMBER = 2 * MOST_BLOCKS
"""A connection's own blocks come first, then loans."""

_Where = tuple[int, int, memoryview | None]
"""A block's number, how much of it is used [bytes], and where to copy arrays to."""
_Placed = tuple[Block, int, Pieces, _Where]
"""A block, the slot of its receiver, the pieces to be sent, and where arrays are."""


class Connection:
    """Sends and receives frames; one thread at a time in each direction.

    Deadlines are moments of the monotonic clock [s]. `is_local` says that it needs no
    network; `is_lost` that the other computer was silent for too long, once `is_idle`
    has found that; `is_over` that no more comes back over it (`follow`).
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        keep_private(connection)
        self.is_local = connection.family == socket.AF_UNIX
        self._channel = _channel.Channel(connection.fileno(), LOST_AFTER)
        self.is_lost = self.is_over = False
        self._reader: threading.Thread | None = None
        self._closing = threading.Lock()
        self._pool = Pool(Block)
        self._lenders: dict[int, _channel.Lender] = {}
        self._slot: int | None = None
        self._loans: WeakValueDictionary[int, LoanBlock] = WeakValueDictionary()

    @property
    def has_blocks(self) -> bool:
        """Whether either end has shared memory for it."""
        return bool(self._lenders or self._pool)

    def is_idle(self) -> bool:
        """Return at once whether the other end is there, and said nothing unexpected.

        Over AF_UNIX sending fails when it is gone; TCP accepts bytes for nobody.
        """
        try:
            said = self._connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
            return bool(said) and self._reader is not None
        except BlockingIOError:
            self.is_lost = self._channel.is_lost()
            return not self.is_lost
        except OSError as error:
            self.is_lost = error.errno in _LOST
        return False

    def close(self) -> None:
        """Close the connection; arrays that were received stay as they are."""
        if self._reader is not None:
            self.end()
            self._reader.join(LOST_AFTER)
        with self._closing:
            self._connection.close()
        self._pool.close()
        self._lenders.clear()
        slot, self._slot = self._slot, None
        if slot is not None:
            LOANS.give_slot_back(slot)

    def end(self, how: int = socket.SHUT_RDWR) -> None:
        """Let its user find it closed; from any thread.

        With ``socket.SHUT_RD`` what has come is still read, and may be answered.
        """
        with contextlib.suppress(OSError):
            self._connection.shutdown(how)

    def follow(self, handle: Callable[[Frame], bool]) -> None:
        """Let a thread take what comes back, until `handle` returns False.

        Raises
        ------
        Unavailable
            No thread can be started.
        """
        self._reader = threading.Thread(
            target=self._follow, args=(handle,), name="credit", daemon=True
        )
        try:
            self._reader.start()
        except RuntimeError as error:
            self._reader = None
            raise Unavailable(str(error)) from error

    def send_back(self, pieces: Pieces) -> bool:
        """Send a frame, from any thread, if the other end takes it at once.

        Else nothing more goes this way: part of the frame may have been sent.
        """
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
        """Send a frame.

        Raises
        ------
        WireError
            The frame is larger than `LARGEST`; nothing was sent.
        Timeout
            The other end did not take it in time. Part of it may have been sent: the
            connection must be closed.
        Unavailable
            The other end is gone, and has not got the frame.
        """
        placed = self._place(pieces, deadline) if len(pieces) > _INLINE else None
        if placed is None:
            self._channel.send(pieces, deadline, LARGEST)
            return
        block, slot, pieces, where = placed
        try:
            block.lend(slot)
            self._channel.send(pieces, deadline, LARGEST, *where)
        except BaseException:
            # also when a signal's handler raises: else the block were lost for good
            block.take_back(slot)
            raise

    def ask(self, pieces: Pieces, deadline: float) -> Frame | None:
        """Send a call and return its answer.

        None when the other end was gone before, and has not got the call. Raises what
        `send` and `receive` do; after any of it the connection must be closed.
        """
        try:
            placed = self._place(pieces, deadline) if len(pieces) > _INLINE else None
        except Unavailable:
            return None
        ask, lenders = self._channel.ask, self._lenders
        if placed is None:
            got = ask(pieces, deadline, LARGEST, lenders)
        else:
            # no block is taken back after an error: the other end may read it
            block, slot, pieces, where = placed
            block.lend(slot)
            got = ask(pieces, deadline, LARGEST, lenders, *where)
            if got is None:
                block.take_back(slot)
        if got is None or type(got) is Frame:
            return got
        return self._with_block(got, deadline)

    def receive(self, deadline: float = math.inf) -> Frame:
        """Return the next frame.

        Raises
        ------
        Timeout
            It did not come in time.
        Unavailable
            The other end is gone.
        WireError
            It is not a frame; after `Unreadable`, the connection must be closed.
        """
        got = self._channel.receive(deadline, LARGEST, self._lenders)
        return got if type(got) is Frame else self._with_block(got, deadline)

    def _follow(self, handle: Callable[[Frame], bool]) -> None:
        try:
            while handle(self.receive()):
                pass
        except (Unavailable, Timeout, WireError):
            self.is_over = True

    def _with_block(
        self, got: tuple[int, int, bytes] | Frame, deadline: float
    ) -> Frame:
        """Return the frame that comes after a new block."""
        while not isinstance(got, Frame):
            block, used, data = got
            if not self.is_local:
                raise Unreadable(f"a shared block {block} was announced over TCP")
            if not block & _NEW:
                raise Unreadable(f"there is no shared block {block}")
            slot = int.from_bytes(data, "little")
            self._accept(block ^ _NEW, used, slot, deadline)
            got = self._channel.receive(deadline, LARGEST, self._lenders)
        return got

    def _place(self, pieces: Pieces, deadline: float) -> _Placed | None:
        """Find a block for the arrays of a frame; None when they go inline."""
        size = sum(map(len, pieces[_INLINE + 1 :]))
        if size > LARGEST:
            raise WireError(f"arrays of {size} B; {LARGEST} B is the largest")
        if size < THRESHOLD or not self.is_local:
            return None
        if len(pieces) == _ALONE and (placed := self._place_loan(pieces, deadline)):
            return placed
        try:
            block, is_new = self._pool.take(size)
        except OSError:  # no memory or file is left: the socket takes them
            return None
        if block is None:
            return None
        if is_new:
            self._introduce(block, block.number, deadline)
        return block, 0, pieces, (block.number, size, block.memory)

    def _place_loan(self, pieces: Pieces, deadline: float) -> _Placed | None:
        """Find the block on which the array lies already.

        None when there is none, or the receiver has it: there is one byte to give it
        back.
        """
        block = LOANS.find(pieces[_INLINE + 1])
        if block is None:
            return None
        if self._slot is None:
            self._slot = LOANS.take_slot()
        slot = self._slot
        if slot is None or block.is_lent(slot):
            return None
        number = MOST_BLOCKS + block.number
        if self._loans.get(number) is not block:
            self._introduce(block, number, deadline, slot.to_bytes(2, "little"))
            self._loans[number] = block
        where = number, len(pieces[_INLINE + 1]), None
        return block, slot, pieces[:_INLINE], where

    def _introduce(
        self, block: Block, number: int, deadline: float, slot: bytes = b""
    ) -> None:
        self._channel.send([slot], deadline, LARGEST, number | _NEW, block.capacity)
        if self._channel.take(1, deadline) != _READY:
            raise Unavailable("the other end takes no shared memory")
        try:
            socket.send_fds(self._connection, [_READY], [block.file])
        except OSError as error:
            raise Unavailable(f"the other end is gone: {error}") from error

    def _accept(self, number: int, capacity: int, slot: int, deadline: float) -> None:
        """Map a block that the other end announced; its file comes soon."""
        if not (0 < number <= _MOST_NUMBER and 0 < capacity <= MOST_BYTES):
            raise Unreadable(f"a shared block {number} of {capacity} B was announced")
        if slot >= DATA:
            raise Unreadable(f"a shared block with slot {slot} was announced")
        poll = select.poll()
        poll.register(self._connection, select.POLLIN)
        left = min(LOST_AFTER, deadline - time.monotonic())
        try:
            self._connection.sendall(_READY)
            if not poll.poll(max(0.0, 1000 * left)):
                raise Timeout("no file came for a shared block")
            data, files, _, _ = socket.recv_fds(self._connection, 1, 1)
        except OSError as error:
            raise Unavailable(f"the other end is gone: {error}") from error
        if not data:
            raise Unavailable("the other end is gone: it announced a block at its end")
        if not files:
            raise Unreadable("a shared block was announced, and no file came")
        try:
            self._lenders[number] = lender(files[0], capacity, slot)
        except (OSError, ValueError) as error:
            raise Unreadable(f"a shared block cannot be mapped: {error}") from error
        finally:
            os.close(files[0])
