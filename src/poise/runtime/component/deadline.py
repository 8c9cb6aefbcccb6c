"""How long a caller still waits, and how to limit the calls of a block."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

from poise.errors import UsageError
from poise.runtime import _calls
from poise.wire.connections import connection

_LONGEST = 1e9
"""What is longer is no limit [s]."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Give up the calls of a block that are not answered in time, by `Timeout`.

    For when an answer is wanted sooner than a connector's `limit`: what is longer than
    that, or than an outer block, changes nothing.

    Parameters
    ----------
    seconds
        For all calls of the block together; with 0 or less none is made [s].

    Raises
    ------
    UsageError
        `seconds` is no number.
    """
    if math.isnan(seconds):
        raise UsageError("within(nan): give a number of seconds")
    before = _calls.deadline()
    if seconds < _LONGEST:
        moment = time.monotonic_ns() + round(1e9 * max(seconds, -_LONGEST))
        _calls.set_deadline(min(before, moment))
    try:
        yield
    finally:
        _calls.set_deadline(before)


def time_left() -> float:
    """Return how long the caller of what runs on this thread waits still [s].

    0 when it gave up or ended: nobody takes the answer, and the callee may
    stop. Infinite in a timer, a message and a hook, and on threads of your own.
    """
    left = max(0.0, _calls.time_left(math.inf))
    return 0.0 if left > 0.0 and connection.is_gone() else left
