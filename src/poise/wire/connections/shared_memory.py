"""Blocks of shared memory for the arrays that cross a connection.

A block is an anonymous file (``memfd_create``) that both ends map. The sender copies
arrays into it, and the receiver's arrays are read-only views on it. The block's first
word tells its owner: the sender sets it, and the receiver clears it when the last array
on it is gone; only then is the block used again. When a receiver keeps its arrays, the
sender takes another block, or sends through the socket when there is none.

Waking a receiver takes about as long as copying 1 MB. So the sender marks the block as
being filled, notifies the receiver, copies the rest meanwhile, and then marks the block
as the receiver's, which waits for that (``native/filling.cpp``).

A block has no name in the file system, so the kernel frees what a crash leaves behind.
"""

from __future__ import annotations

import fcntl
import mmap
import os
from collections.abc import Callable
from typing import Generic, TypeVar

from poise.wire import _channel
from poise.wire.codec import WireError

THRESHOLD = 1 << 16
"""Fewer bytes of arrays go through the socket, which is as quick [bytes]."""
MOST_BLOCKS = 8
"""Blocks that one end of a connection may have."""
MOST_BYTES = 1 << 27
"""Memory of these blocks in all [bytes]."""

DATA = mmap.PAGESIZE
"""Where the data begin [bytes]: the page before holds bytes that both ends write."""
LENT = 1
FREE = 0
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL


B = TypeVar("B", bound="Block")


class Block:
    """The sender's side of a block with room for `capacity` bytes.

    Sending copies arrays to its `memory`, or leaves them there.
    """

    def __init__(self, number: int, capacity: int) -> None:
        self.number = number
        self.capacity = capacity
        self.file = os.memfd_create("poise", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.ftruncate(self.file, DATA + capacity)
            fcntl.fcntl(self.file, fcntl.F_ADD_SEALS, _SEALS)
            self._map = mmap.mmap(
                self.file, 0, mmap.MAP_SHARED | mmap.MAP_POPULATE, mmap.PROT_WRITE
            )
        except OSError:
            os.close(self.file)
            raise
        self.memory = memoryview(self._map)

    def is_free(self) -> bool:
        """Return whether the receiver has no array on it."""
        return self._map[0] == FREE

    def lend(self, slot: int = 0) -> None:
        """Set its byte `slot`: the receiver owns it once its frame came."""
        self._map[slot] = LENT

    def take_back(self, slot: int = 0) -> None:
        """Undo `lend`: no frame was sent."""
        self._map[slot] = FREE

    def close(self) -> None:
        """Give up this side's map; the receiver's arrays stay as they are."""
        self.memory.release()
        self._map.close()
        os.close(self.file)


class Pool(Generic[B]):
    """Blocks that are used again and again.

    Parameters
    ----------
    make
        Makes one: its number, and its capacity [bytes].
    """

    def __init__(self, make: Callable[[int, int], B]) -> None:
        self._make = make
        self._blocks: dict[int, B] = {}

    def __bool__(self) -> bool:
        return bool(self._blocks)

    def blocks(self) -> list[B]:
        """Return all of them."""
        return list(self._blocks.values())

    def take(self, size: int) -> tuple[B | None, bool]:
        """Return a free block for `size` bytes, and whether it is new.

        None when the receiver has not given back enough of them.
        """
        found = None
        for block in self._blocks.values():
            fits_better = found is None or block.capacity < found.capacity
            if block.capacity >= size and fits_better and block.is_free():
                found = block
        if found is not None:
            return found, False
        free = [block for block in self._blocks.values() if block.is_free()]
        capacity = max(THRESHOLD, 1 << (size - 1).bit_length())
        self._make_room(capacity, sorted(free, key=_capacity))
        used = sum(map(_capacity, self._blocks.values()))
        if len(self._blocks) == MOST_BLOCKS or used + capacity > MOST_BYTES:
            return None, False
        number = next(n for n in range(1, MOST_BLOCKS + 1) if n not in self._blocks)
        block = self._blocks[number] = self._make(number, capacity)
        return block, True

    def give_up(self, block: B) -> None:
        """Use a block no more."""
        self._blocks.pop(block.number).close()

    def close(self) -> None:
        """Give up all blocks."""
        while self._blocks:
            self._blocks.popitem()[1].close()

    def _make_room(self, capacity: int, free: list[B]) -> None:
        """Give up free blocks, all of them too small, as far as a new one needs it."""
        for block in free:
            used = sum(map(_capacity, self._blocks.values()))
            if len(self._blocks) < MOST_BLOCKS and used + capacity <= MOST_BYTES:
                return
            self.give_up(block)


def lender(file: int, capacity: int, slot: int = 0) -> _channel.Lender:
    """Return the receiver's side of a block, which lends what was sent on it.

    The block is given back when the last view of that is gone; `slot` is the number of
    the byte that says so. WireError when the file is not one of `capacity` bytes.
    """
    if fcntl.fcntl(file, fcntl.F_GET_SEALS) & _SEALS != _SEALS:
        raise WireError("a shared block may shrink: not sealed")
    if os.fstat(file).st_size != DATA + capacity:
        raise WireError(f"a shared block is not of {capacity} B")
    shared = mmap.MAP_SHARED | mmap.MAP_POPULATE
    flags = mmap.mmap(file, DATA, shared, mmap.PROT_WRITE)
    data = mmap.mmap(file, capacity, shared, mmap.PROT_READ, offset=DATA)
    return _channel.Lender(data, flags, slot)


def _capacity(block: Block) -> int:
    return block.capacity
