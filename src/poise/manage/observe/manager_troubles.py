"""What troubles the manager itself: its journal, and its computer's clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from poise.clock import wall_time
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation

_LEAST_JUMP = 1.0
"""A clock that jumps by less is not worth a word [s]."""
_SHOWN = 60.0
"""A jump is a deviation for this time [s]."""


class ManagerTroubles:
    """Looks at the manager itself. The robot goes on, and nothing moves for it.

    Parameters
    ----------
    wall, now
        The time [s], by the clock that people set, and by one that never jumps.
    """

    def __init__(
        self,
        journal: Journal,
        wall: Callable[[], float] = wall_time,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._journal = journal
        self._wall = wall
        self._now = now
        self._ahead = wall() - now()
        self._jumped: tuple[float, Deviation] | None = None
        self._unwritten: Deviation | None = None

    def look(self) -> None:
        """Journal a jump of the clock; call it several times a second."""
        ahead, now = self._wall() - self._now(), self._now()
        jump, self._ahead = ahead - self._ahead, ahead
        if abs(jump) >= _LEAST_JUMP:
            way = "forward" if jump > 0 else "back"
            what = (
                f"the clock of the manager's computer jumped {way} by {abs(jump):.0f} "
                "s: times before that are off; nothing else depends on it"
            )
            self._jumped = now, self._deviation(what)
            self._journal.note("wrong", what, seconds=jump)
        if self._jumped is not None and now - self._jumped[0] > _SHOWN:
            self._jumped = None
        trouble = self._journal.trouble
        if not trouble:
            self._unwritten = None
        elif self._unwritten is None:
            self._unwritten = self._deviation(trouble)

    def deviations(self) -> list[Deviation]:
        """Return what is wrong now; from any thread."""
        jumped = self._jumped and self._jumped[1]
        return [each for each in (self._unwritten, jumped) if each is not None]

    def _deviation(self, what: str) -> Deviation:
        return Deviation(what=what, computer="", since=self._wall())
