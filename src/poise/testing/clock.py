"""A clock that stands still until it is told to go on."""

from __future__ import annotations


class VirtualClock:
    """Time for tests; a `poise.clock.Clock`.

    Parameters
    ----------
    start
        The first moment [s].
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        """Return the present moment [s]."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Let `seconds` [s] pass, at once."""
        self._now += seconds
