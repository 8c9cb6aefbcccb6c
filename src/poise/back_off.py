"""How long to wait before a process that ended is started again."""

from __future__ import annotations

_FIRST_DELAY, _LONGEST_DELAY = 0.1, 5.0
"""The second restart is after this time [s], the next after twice that, to this."""
_CALM = 10.0
"""After so long without an end the next restart is at once again [s]."""


class BackOff:
    """The ends of one process, and when it may start again [s]."""

    def __init__(self) -> None:
        self.again_at = float("-inf")
        self._delay = 0.0
        self._ended_at = float("-inf")

    def note_end(self, now: float, jitter: float = 1.0) -> None:
        """Count an end at `now` [s]; `jitter` in [0.5, 1] spreads many over time."""
        if now - self._ended_at > _CALM:
            self._delay = 0.0
        self._ended_at = now
        self.again_at = now + self._delay * jitter
        self._delay = min(max(_FIRST_DELAY, 2 * self._delay), _LONGEST_DELAY)
