"""The clock of a container's components, and what it knows of other computers'."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from poise.clock import DRIFT, Elapsed, Stamp, SystemClock
from poise.wire.records.heartbeat_records import ClockStatus


class ComputerClock(SystemClock):
    """The clock of one computer."""

    def __init__(self, computer: str) -> None:
        super().__init__(computer)
        self.others: Mapping[str, ClockStatus] = {}

    def since(self, stamp: Stamp) -> Elapsed | None:
        """Return how long ago a stamp was, with what is known of its clock."""
        if stamp.computer == self._computer:
            return super().since(stamp)
        ahead = self.ahead(stamp.computer)
        if ahead is None:
            return None
        return Elapsed(self.now() + ahead.value - stamp.at, ahead.error)

    def ahead(self, computer: str) -> Elapsed | None:
        """Return how far another computer's clock is ahead [s]; None: not known."""
        known = self.others.get(computer)
        if known is None:
            return None
        error = known.error + DRIFT * max(0.0, self.now() - known.at)
        return Elapsed(known.offset, error)


class RemoteClock:
    """How far the clock at the other end is ahead, as far as it is known."""

    __slots__ = ("_ask", "ahead", "error", "most")

    def __init__(self, ask: Callable[[], Elapsed | None] | None = None) -> None:
        self._ask = ask
        self.ahead = self.most = 0.0 if ask is None else math.nan
        self.error = 0.0
        self.update()

    def update(self) -> None:
        """Update from what is known now; once a second, because clocks drift."""
        known = self._ask() if self._ask else None
        if known is not None:
            self.ahead, self.error, self.most = known.value, known.error, known.most
