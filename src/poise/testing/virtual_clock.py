"""A clock that advances only when a test says so."""

from __future__ import annotations

from poise.clock import Elapsed, Stamp


class VirtualClock:
    """Time for tests; a `poise.clock.ComponentClock`.

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

    def stamp(self, at: float | None = None) -> Stamp:
        """Return the present moment, or `at` [s]."""
        return Stamp(self._now if at is None else at)

    def since(self, stamp: Stamp) -> Elapsed:
        """Return how long ago a stamp was; there is one computer, whatever it says."""
        return Elapsed(self._now - stamp.at)
