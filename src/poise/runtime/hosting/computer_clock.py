"""The clock of a container's components, which knows of other computers' clocks."""

from __future__ import annotations

from collections.abc import Mapping

from poise.clock import DRIFT, Elapsed, Stamp, SystemClock
from poise.wire.records.clocks import ClockStatus


class ComputerClock(SystemClock):
    """The clock of one computer.

    Attributes
    ----------
    others
        Computer -> its clock, as the agent says once a second.
    """

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
