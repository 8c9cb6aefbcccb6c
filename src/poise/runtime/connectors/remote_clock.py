"""The clock at the other end of a connector, to tell how old is what comes."""

from __future__ import annotations

import math
from collections.abc import Callable

from poise.clock import Elapsed


class RemoteClock:
    """How far the clock at the other end is ahead, as it was known last.

    What came is as old as its frame says (`poise.wire.frame.Frame.age`), plus `ahead`.

    Parameters
    ----------
    ask
        Returns how far it is ahead, None as long as nobody knows. Not given: it is
        this computer's clock.
    """

    __slots__ = ("_ask", "ahead", "error")

    def __init__(self, ask: Callable[[], Elapsed | None] | None = None) -> None:
        self._ask = ask
        self.ahead = 0.0 if ask is None else math.nan
        self.error = 0.0
        self.look()

    def look(self) -> None:
        """Learn what is known now; clocks run apart, so this is for every second."""
        known = self._ask() if self._ask else None
        if known is not None:
            self.ahead, self.error = known.value, known.error


def nobody_knows(_: str) -> None:
    """Say that of any computer nobody knows how far its clock is ahead."""
