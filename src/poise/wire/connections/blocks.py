"""Blocks of shared memory (memfd) for the arrays that cross connections.

Arrays are copied into a block, or lie there from the start (`loan`); the receiver's are
read-only views. The first page has a byte, a *slot*, for each connection and the loan:
the sender sets it, the receiver clears it when the last array is gone; a third value
says that the block is being filled (``native/filling.h``). A block whose slots are
clear is used again; one still lent when its connection ends is given up. It has no name
in the file system, so the kernel frees what a crash leaves behind.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import threading
import weakref
from math import prod
from operator import index
from typing import TYPE_CHECKING, Any

from poise.wire import _channel
from poise.wire.codec import Bytes, WireError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import DTypeLike

THRESHOLD = 1 << 16
"""Fewer bytes of arrays go through the socket, which is as quick [bytes]."""
MOST_LENT = 8
"""Blocks that the receiver of one connection may have, and loans of a process."""
MOST_BLOCKS = 64
"""Blocks of a process."""
MOST_BYTES = 1 << 28
"""Memory of these blocks in all [bytes]."""

DATA = mmap.PAGESIZE
"""Where the data begin [bytes]: the page before holds bytes that both ends write."""
SLOTS = 1 << 12
"""Bytes of that page which are slots: a page may have 64 KiB, and all are looked at."""
OWN = 0
"""The slot of a loan, which its own process has."""
_FREE, _LENT = 0, 1
_ALL_FREE = bytes(SLOTS)
# qemu maps what is only to be written so that the kernel cannot read it: EFAULT
_ACCESS = mmap.PROT_READ | mmap.PROT_WRITE
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL


class Block:
    """The sender's side of a block with room for `capacity` bytes."""

    def __init__(self, number: int, capacity: int) -> None:
        self.number = number
        self.capacity = capacity
        self.file = os.memfd_create("poise", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        # a connection may be about to send its file when it is given up
        weakref.finalize(self, os.close, self.file)
        os.ftruncate(self.file, DATA + capacity)
        fcntl.fcntl(self.file, fcntl.F_ADD_SEALS, _SEALS)
        self._map = mmap.mmap(
            self.file, 0, mmap.MAP_SHARED | mmap.MAP_POPULATE, _ACCESS
        )
        self.memory = memoryview(self._map)
        self.address = _channel.address(self.memory) + DATA
        self._loan: weakref.ref[np.ndarray] | None = None
        self._owner = os.getpid()

    def is_free(self) -> bool:
        """Return whether nobody has an array on it."""
        return self._map[:SLOTS] == _ALL_FREE

    def is_lent(self, slot: int) -> bool:
        """Return whether a slot's user has an array on it."""
        return self._map[slot] != _FREE

    def lend(self, slot: int) -> None:
        """Set a slot: its user owns it. From now on nobody may write to a loan."""
        loan = self._loan() if self._loan else None
        if loan is not None:
            loan.flags.writeable = False
        self._map[slot] = _LENT

    def release(self, slot: int) -> None:
        """Undo `lend`: no frame was sent, or the loan is gone."""
        if self._owner == os.getpid():  # a forked process has a copy of the loan
            self._map[slot] = _FREE

    def make_loan(self, shape: Any, dtype: DTypeLike) -> np.ndarray:  # noqa: ANN401, as numpy's
        """Return an array on it, which has the slot `OWN` for as long as it lives."""
        import numpy as np  # noqa: PLC0415, only where users' arrays are

        array: np.ndarray = np.ndarray(shape, dtype, self._map, DATA)
        self._loan = weakref.ref(array)
        weakref.finalize(array, self.release, OWN).atexit = False
        return array


class Blocks:
    """The blocks of a process and the slots of its connections, for any thread."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin with none, as a process that a component forks: it has copies."""
        self._blocks: dict[int, Block] = {}
        self._changing = threading.Lock()
        self._free_slots = list(reversed(range(1, SLOTS)))

    def allocate(self, size: int, slot: int) -> Block | None:
        """Return a free block for `size` bytes, lent to a slot; None: there is none."""
        with self._changing, contextlib.suppress(OSError):
            blocks = self._blocks.values()
            if sum(block.is_lent(slot) for block in blocks) >= MOST_LENT:
                return None
            free = sorted((b for b in blocks if b.is_free()), key=_capacity)
            fitting = (block for block in free if block.capacity >= size)
            block = next(fitting, None) or self._make(size, free)
            if block is not None:
                block.lend(slot)
            return block
        return None

    def find(self, sent: Bytes) -> Block | None:
        """Return the block whose loan begins where `sent` does, if there is one."""
        address = _channel.address(sent)
        with self._changing:
            blocks = (b for b in self._blocks.values() if b.address == address)
            return next(blocks, None)

    def allocate_slot(self) -> int | None:
        """Return a slot for a connection; None when all are used."""
        with self._changing:
            return self._free_slots.pop() if self._free_slots else None

    def free_slot(self, slot: int) -> None:
        """End a connection: blocks that are lent over it are not used again."""
        with self._changing:
            self._free_slots.append(slot)
            is_last = len(self._free_slots) == len(range(1, SLOTS))
            for block in list(self._blocks.values()):
                if block.is_lent(slot) or (is_last and block.is_free()):
                    del self._blocks[block.number]

    def _make(self, size: int, free: list[Block]) -> Block | None:
        """Make a block, and give up free ones, all too small, as far as it needs it."""
        capacity = max(THRESHOLD, 1 << (size - 1).bit_length())
        room = MOST_BYTES - capacity
        blocks = self._blocks
        while len(blocks) == MOST_BLOCKS or sum(map(_capacity, blocks.values())) > room:
            if not free:
                return None
            del blocks[free.pop(0).number]
        number = next(n for n in range(1, MOST_BLOCKS + 1) if n not in blocks)
        block = blocks[number] = Block(number, capacity)
        return block


BLOCKS = Blocks()
"""Those of this process."""
os.register_at_fork(after_in_child=BLOCKS.forget)


def lender(file: int, slot: int) -> _channel.Lender:
    """Return the receiver's side of a block; WireError when the file is none."""
    if fcntl.fcntl(file, fcntl.F_GET_SEALS) & _SEALS != _SEALS:
        raise WireError("a shared block may shrink: not sealed")
    capacity = os.fstat(file).st_size - DATA
    if not (0 < capacity <= MOST_BYTES and slot < SLOTS):
        raise WireError(f"a shared block of {capacity} B with slot {slot}")
    shared = mmap.MAP_SHARED | mmap.MAP_POPULATE
    flags = mmap.mmap(file, DATA, shared, _ACCESS)
    data = mmap.mmap(file, capacity, shared, mmap.PROT_READ, offset=DATA)
    return _channel.Lender(data, flags, slot)


def loan(shape: int | tuple[int, ...], dtype: DTypeLike = float) -> np.ndarray:
    """Return a new array to be filled and sent; on one computer nothing copies it.

    It lies in shared memory. A message, argument or result that has it, or a part that
    begins where it begins, as its only array reaches other containers of the computer
    as it is; to other computers, and together with other arrays, it is copied as any
    other. Once it was sent it must not be changed, and is read-only where it was lent.

    An array of less than 64 KB, or one more than 8 that are in use here, or without
    room in the 256 MiB of this process, is an ordinary one.

    Parameters
    ----------
    shape
        Sides [elements], each 0 or more.
    dtype
        What it holds, as NumPy names it.

    Returns
    -------
    An array of any content, of that shape.
    """
    import numpy as np  # noqa: PLC0415, only where users' arrays are

    kind = np.dtype(dtype)
    given: Any = (shape,) if np.ndim(shape) == 0 else shape
    sides = tuple(map(index, given))  # NumPy's numbers have no room for all sizes
    size = prod(sides) * kind.itemsize
    if size >= THRESHOLD and not kind.hasobject and min(sides) > 0:
        block = BLOCKS.allocate(size, OWN)
        if block is not None:
            return block.make_loan(sides, kind)
    return np.empty(sides, kind)


def _capacity(block: Block) -> int:
    return block.capacity
