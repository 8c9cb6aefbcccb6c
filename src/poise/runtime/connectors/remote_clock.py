"""The clock at the other end of a connector, to tell the age of a frame."""

from __future__ import annotations

import math
from collections.abc import Callable

from poise.clock import Elapsed


class RemoteClock:
    """How far the clock at the other end is ahead, as far as it is known.

    A frame is as old as it says (`poise.wire.frame.Frame.age`), plus `ahead`.

    Parameters
    ----------
    ask
        Returns how far it is ahead, None while it is not known. Not given: it is
        this computer's clock.
    """

    __slots__ = ("_ask", "ahead", "error", "most")

    def __init__(self, ask: Callable[[], Elapsed | None] | None = None) -> None:
        self._ask = ask
        self.ahead = self.most = 0.0 if ask is None else math.nan
        self.error = 0.0
        self.look()

    def look(self) -> None:
        """Update from what is known now; once a second, because clocks drift."""
        known = self._ask() if self._ask else None
        if known is not None:
            self.ahead, self.error, self.most = known.value, known.error, known.most


def nobody_knows(_: str) -> None:
    """Return None: no computer's clock is known."""
