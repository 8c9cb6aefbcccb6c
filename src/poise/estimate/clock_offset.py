"""How far another computer's clock is ahead, from round trips, and how sure that is.

A message leaves here at t0, arrives there at t1, its answer leaves there at t2 and
arrives here at t3: the four time stamps of NTP. Whatever the ways there and back took,
the offset of the other clock lies between t2 - t3 and t1 - t0. Quick round trips bound
it tightly; as two clocks run apart, an older bound is widened by its age. All bounds
hold at once, so their intersection does (Marzullo).
"""

from __future__ import annotations

from collections import deque

from msgspec import Struct

from poise.clock import DRIFT, Elapsed

_KEPT = 64


class RoundTrip(Struct, frozen=True):
    """When a message left here, came there, left there and came back here [s].

    The first and the last are read on this computer's clock, the others on the other's.
    """

    sent: float
    received: float
    answered: float
    returned: float


class Offset(Struct, frozen=True):
    """The other clock minus this one: surely within `error` of `value` [s]."""

    value: float
    error: float


class ClockOffset:
    """The offset of one other computer's clock, from the last round trips."""

    def __init__(self) -> None:
        self._bounds: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)

    def add(self, trip: RoundTrip) -> None:
        """Take a round trip; one whose times contradict each other is passed over."""
        low, high = trip.answered - trip.returned, trip.received - trip.sent
        if low > high or trip.answered < trip.received:
            return
        self._bounds.append((trip.returned, low, high))

    def at(self, now: float) -> Offset | None:
        """Return the offset at `now` [s, on this clock]; None before any round trip.

        When the bounds contradict each other a clock was set: the older ones go.
        """
        low, high = float("-inf"), float("inf")
        for returned, least, most in reversed(self._bounds):
            wide = DRIFT * abs(now - returned)
            if max(low, least - wide) > min(high, most + wide):
                self._forget_until(returned)
                break
            low, high = max(low, least - wide), min(high, most + wide)
        if low == float("-inf"):
            return None
        return Offset((low + high) / 2, (high - low) / 2)

    def delay(self, there: float, here: float) -> Elapsed | None:
        """Return how long something took that left there and came here [s].

        Parameters
        ----------
        there
            When it left, on the other computer's clock [s].
        here
            When it came, on this computer's clock [s].
        """
        offset = self.at(here)
        if offset is None:
            return None
        return Elapsed(here - (there - offset.value), offset.error)

    def _forget_until(self, returned: float) -> None:
        while self._bounds and self._bounds[0][0] <= returned:
            self._bounds.popleft()
