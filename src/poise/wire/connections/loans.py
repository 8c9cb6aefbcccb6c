"""Arrays that lie in shared memory from the start, so that sending them copies nothing.

A loan is an array on a block of its own. Any connection may lend the block to its
receiver, several at a time: each connection has a slot, which is a byte in the block's
first page. The receiver clears it when its arrays are gone. The block is used again
when all these bytes are clear and the sender's own array is gone, too.

When a connection ends, nobody clears its byte: a block that is still lent over it is
given up, and the kernel frees it when the last process unmaps it.
"""

from __future__ import annotations

import contextlib
import os
import threading
import weakref
from math import prod
from typing import TYPE_CHECKING, Any

from poise.wire import _channel
from poise.wire.codec import Bytes
from poise.wire.connections.shared_memory import DATA, FREE, THRESHOLD, Block, Pool

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import DTypeLike

_SLOTS = range(1, DATA)
"""The bytes of a block's first page for connections; the first is the pool's own."""
_ALL_FREE = bytes(DATA)


class LoanBlock(Block):
    """The sender's side of a block with a loan on it."""

    def __init__(self, number: int, capacity: int) -> None:
        super().__init__(number, capacity)
        # a connection may still be about to send its file when it is given up
        weakref.finalize(self, os.close, self.file)
        self.address = _channel.address(self.memory) + DATA
        self._array: weakref.ref[np.ndarray] | None = None

    @property
    def array(self) -> np.ndarray | None:
        """The loan; None when it is gone."""
        return self._array() if self._array else None

    def is_free(self) -> bool:
        """Return whether nobody has an array on it."""
        return self.array is None and self._map[:DATA] == _ALL_FREE

    def make_array(self, shape: Any, dtype: DTypeLike) -> np.ndarray:  # noqa: ANN401, as numpy's
        """Put the loan on it."""
        import numpy as np  # noqa: PLC0415, only where users' arrays are

        array: np.ndarray = np.ndarray(shape, dtype, self._map, DATA)
        self._array = weakref.ref(array)
        return array

    def is_lent(self, slot: int) -> bool:
        """Return whether the receiver of a connection has an array on it."""
        return self._map[slot] != FREE

    def lend(self, slot: int = 0) -> None:
        """Lend it to the receiver of a connection; from now on nobody may write."""
        array = self.array
        if array is not None:
            array.flags.writeable = False
        super().lend(slot)

    def close(self) -> None:
        """No-op: the block is freed when its last user drops it."""


class Loans:
    """The loans of a process and the slots of its connections, for any thread."""

    def __init__(self) -> None:
        self._pool = Pool(LoanBlock)
        self._changing = threading.Lock()
        self._free_slots = list(reversed(_SLOTS))

    def new(self, shape: Any, dtype: DTypeLike) -> np.ndarray:  # noqa: ANN401, as numpy's
        """Return an array of any content; an ordinary one when there is no block."""
        import numpy as np  # noqa: PLC0415, only where users' arrays are

        kind = np.dtype(dtype)
        sides = (shape,) if isinstance(shape, int) else tuple(shape)
        size = prod(sides) * kind.itemsize
        if size >= THRESHOLD and not kind.hasobject and min(sides) > 0:
            # without memory for a block, an array may still be had
            with self._changing, contextlib.suppress(OSError):
                block, _ = self._pool.take(size)
                if block is not None:
                    return block.make_array(sides, kind)
        return np.empty(sides, kind)

    def find(self, sent: Bytes) -> LoanBlock | None:
        """Return the block whose loan begins where `sent` does, if there is one."""
        if not self._pool:
            return None
        address = _channel.address(sent)
        with self._changing:
            for block in self._pool.blocks():
                if block.address == address:
                    return block
        return None

    def take_slot(self) -> int | None:
        """Return a slot for a connection; None when all are used."""
        with self._changing:
            return self._free_slots.pop() if self._free_slots else None

    def give_slot_back(self, slot: int) -> None:
        """End a connection: blocks that are lent over it are not used again."""
        with self._changing:
            for block in self._pool.blocks():
                if block.is_lent(slot):
                    self._pool.give_up(block)
            self._free_slots.append(slot)


LOANS = Loans()
"""Those of this process; it has none when it forks containers."""


def loan(shape: int | tuple[int, ...], dtype: DTypeLike = float) -> np.ndarray:
    """Return a new array to be filled and sent; on one computer nothing copies it.

    It lies in shared memory. A message, argument or result that has it, or a part that
    begins where it begins, as its only array reaches other containers of the computer
    as it is; to other computers, and together with other arrays, it is copied as any
    other. Once it was sent it must not be changed, and is read-only where it was lent.

    An array of less than 64 KB, or one more than 8 or 128 MiB that are in use here or
    at their receivers, is an ordinary one.

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
    return LOANS.new(shape, dtype)
