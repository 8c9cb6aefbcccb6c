"""The one seam to time: everything that waits or stamps takes a `Clock`."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Where time comes from.

    Both methods may be called from any thread. Tests pass `poise.testing`'s
    virtual clock instead of `SystemClock`.
    """

    def now(self) -> float:
        """Return the time [s] since some fixed moment; it never steps back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for `seconds` [s]."""
        ...


class SystemClock:
    """The computer's monotonic clock.

    On Linux all processes of one computer, in any namespace, read the same clock.
    """

    def now(self) -> float:
        """Return CLOCK_MONOTONIC [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for `seconds` [s]."""
        time.sleep(seconds)
