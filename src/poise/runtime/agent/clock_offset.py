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
        self._bounds: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)

    def add(
        self, sent: float, received: float, answered: float, returned: float
    ) -> None:
        """Add a round trip [s]; inconsistent times are ignored.

        `sent` and `returned` are on this computer's clock, the others on the other's.
        """
        low, high = answered - returned, received - sent
        if low <= high and received <= answered:
            self._bounds.append((sent, low, high))

    def at(self, now: float) -> ClockStatus | None:
        """Return what is known at `now` [s, on this clock]; None before any round trip.

        When bounds contradict each other a clock was set: older bounds are dropped.
        """
        low, high = float("-inf"), float("inf")
        for began, least, most in reversed(self._bounds):
            wide = DRIFT * abs(now - began)
            lowest, highest = max(low, least - wide), min(high, most + wide)
            if lowest > highest:
                self._forget_until(began)
                break
            low, high = lowest, highest
        if not self._bounds:  # heartbeats that overtook each other contradict all
            return None
        return ClockStatus(
            offset=(low + high) / 2,
            error=(high - low) / 2,
            at=now,
            trip=min(most - least for _, least, most in self._bounds),
        )

    def _forget_until(self, began: float) -> None:
        while self._bounds and self._bounds[0][0] <= began:
            self._bounds.popleft()
