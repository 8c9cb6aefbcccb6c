"""The offset of another computer's clock and its error, from round trips.

A message leaves here at t0 and arrives there at t1; its answer leaves there at t2 and
arrives here at t3: the four time stamps of NTP. The offset of the other clock is
between t2 - t3 and t1 - t0, for any delays. Short round trips give tight bounds. Clocks
drift, so older bounds widen with age. The offset is in the intersection of all bounds
(Marzullo).
"""

from __future__ import annotations

from collections import deque

from poise.clock import DRIFT
from poise.wire.records.clocks import ClockStatus

_KEPT = 64


class ClockOffset:
    """The offset of one other computer's clock, from the last round trips."""

    def __init__(self) -> None:
        self._sent: deque[float] = deque(maxlen=_KEPT)
        # bounds widen with age: what each would have been when this clock showed 0
        self._lows: deque[float] = deque(maxlen=_KEPT)
        self._highs: deque[float] = deque(maxlen=_KEPT)
        self._trips: deque[float] = deque(maxlen=_KEPT)

    def add(
        self, sent: float, received: float, answered: float, returned: float
    ) -> None:
        """Add a round trip [s]; inconsistent times are ignored.

        `sent` and `returned` are on this computer's clock, the others on the other's.
        """
        low, high = answered - returned, received - sent
        if low <= high and received <= answered:
            self._sent.append(sent)
            self._lows.append(low + DRIFT * sent)
            self._highs.append(high - DRIFT * sent)
            self._trips.append(high - low)

    def at(self, now: float) -> ClockStatus | None:
        """Return what is known at `now` [s, on this clock]; None before any round trip.

        When bounds contradict each other a clock was set: older bounds are dropped.
        """
        if not self._sent:
            return None
        wide = DRIFT * now
        low, high = max(self._lows) - wide, min(self._highs) + wide
        if low > high:
            self._forget_contradicted(wide)
            if not self._sent:  # heartbeats that overtook each other contradict all
                return None
            low, high = max(self._lows) - wide, min(self._highs) + wide
        return ClockStatus(
            offset=(low + high) / 2,
            error=(high - low) / 2,
            at=now,
            trip=min(self._trips),
        )

    def _forget_contradicted(self, wide: float) -> None:
        """Forget the newest bound that contradicts newer ones, and all before it."""
        low, high = float("-inf"), float("inf")
        bounds = list(zip(self._sent, self._lows, self._highs, strict=True))
        while low <= high:
            began, least, most = bounds.pop()
            low, high = max(low, least - wide), min(high, most + wide)
        while self._sent and self._sent[0] <= began:
            for each in (self._sent, self._lows, self._highs, self._trips):
                each.popleft()
