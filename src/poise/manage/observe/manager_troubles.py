"""What troubles the manager itself: its files, and its computer's clock."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from typing import Protocol

from msgspec.structs import replace

from poise.clock import wall_time
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation

_LEAST_JUMP = 1.0
"""A clock that jumps by less is not worth a word [s]."""
_SHOWN = 60.0
"""A jump is a deviation for this time [s]."""


class Troubled(Protocol):
    """What may be in trouble."""

    @property
    def trouble(self) -> str:
        """A sentence; empty: all is well."""
        ...


class ManagerTroubles:
    """Looks at the manager itself. The robot goes on, and nothing moves for it.

    Parameters
    ----------
    wall, now
        The time [s], by the clock that people set, and by one that never jumps.
    others
        What else the manager keeps, beside the journal.
    """

    def __init__(
        self,
        journal: Journal,
        wall: Callable[[], float] = wall_time,
        now: Callable[[], float] = time.monotonic,
        others: Iterable[Troubled] = (),
    ) -> None:
        self._journal = journal
        self._wall = wall
        self._now = now
        self._ahead = wall() - now()
        self._jumped: tuple[float, Deviation] | None = None
        self._watched = (journal, *others)
        self._troubles: dict[int, Deviation] = {}

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
        for number, each in enumerate(self._watched):
            self._note(number, each.trouble)

    def deviations(self) -> list[Deviation]:
        """Return what is wrong now; from any thread."""
        jumped = self._jumped
        found = [*self._troubles.copy().values()]
        return [*found, jumped[1]] if jumped is not None else found

    def _note(self, number: int, trouble: str) -> None:
        """Journal that a trouble begins, and ends, but not each of its counts."""
        before = self._troubles.get(number)
        if not trouble:
            if before is not None:
                del self._troubles[number]
                self._journal.note("right", before.end())
            return
        if before is None or _but_counts(before.what) != _but_counts(trouble):
            self._journal.note("wrong", trouble)
            before = self._deviation(trouble)
        self._troubles[number] = replace(before, what=trouble)

    def _deviation(self, what: str) -> Deviation:
        return Deviation(what=what, computer="", since=self._wall())


def _but_counts(sentence: str) -> str:
    return re.sub(r"\d+ (\w+?)s?\b", r"\1", sentence)
