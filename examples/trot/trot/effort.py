"""Work of a declared size, met on every computer: CPU time and memory touched.

What a component computes here in small takes less time than the real thing did. So
each one is an *anytime* algorithm: it goes on improving, piece by piece, until its
thread has used the CPU time that the robot file declares. A piece is real work
of at most some hundred microseconds in NumPy, so that the threads of a process share
the interpreter, on the next block of a working set of the declared size.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from poise.units import BYTES, SECONDS, parse

_SLOWDOWN = float(os.environ.get("POISE_SLOWDOWN", "1"))
# Poise sets it where it emulates a computer but cannot slow it down: then the work is
# that much more, and takes as long as it would there.

BLOCK = 16_384
"""Numbers in a block of the working set: 64 KiB of float32."""

Block = NDArray[np.float32]
"""``(BLOCK,)``"""


class Effort:
    """The CPU time [s] of one cycle, and the memory [bytes] that cycles walk over."""

    def __init__(self, cpu: float, working_set: float = 0.0) -> None:
        self.cpu = cpu * _SLOWDOWN
        blocks = max(1, round(working_set / (4 * BLOCK)))
        # Repeating is as quick as the memory; drawing all of it would delay the start.
        # The period is longer than a block, so that no two blocks are alike.
        pattern = np.random.default_rng(0).random(BLOCK + 1009, dtype=np.float32)
        self._blocks = np.resize(pattern, (blocks, BLOCK))
        self._next = 0

    @classmethod
    def declared(cls, parameters: Mapping[str, Any]) -> Effort:
        """Return the effort of the parameters ``cpu`` and ``working_set``.

        Both are quantities as people write them (``"5 ms"``, ``"8 MiB"``) or plain
        numbers [s, bytes]; without them nothing but the algorithm's own work is done.
        """
        return cls(
            parse(parameters.get("cpu", 0), SECONDS),
            parse(parameters.get("working_set", 0), BYTES),
        )

    def start(self) -> float:
        """Return the CPU time of this thread [s], to be given to `spend`."""
        return time.thread_time()

    def spend(self, piece: Callable[[Block], object], since: float) -> int:
        """Do `piece` with block after block until the cycle's CPU time is used.

        Parameters
        ----------
        piece
            Takes a block; may change it.
        since
            What `start` returned at the beginning of the cycle [s].

        Returns
        -------
        How many pieces were done; 0 when the time was used before.
        """
        pieces = 0
        last = time.thread_time()
        # Ends where one more piece would overshoot by more than it fills.
        while last - since < self.cpu:
            piece(self.next_block())
            pieces += 1
            now = time.thread_time()
            if self.cpu - (now - since) < (now - last) / 2:
                break
            last = now
        return pieces

    def next_block(self) -> Block:
        """Return the next block of the working set; after the last comes the first."""
        block: Block = self._blocks[self._next]
        self._next = (self._next + 1) % len(self._blocks)
        return block
