"""Exceptions that end threads of the manager's process."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable

from poise.clock import wall_time
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation
from poise.threads import SHOWN_FOR

_MOST = 20
"""The most threads whose failures are shown; all failures are journalled."""


class ThreadFailures:
    """Journals each failure, and shows it for `SHOWN_FOR`.

    Parameters
    ----------
    now
        Returns the time [s] by a clock that never jumps.
    """

    def __init__(
        self, journal: Journal, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._journal = journal
        self._now = now
        self._shown: dict[str, tuple[float, Deviation]] = {}

    def note(self, thread: str, error: BaseException) -> None:
        """Take note of a failure, as `poise.threads.hear_failures` reports it."""
        what = (
            f"the thread '{thread}' of the manager's process failed "
            f"({type(error).__name__}: {error}); all else goes on"
        )
        text = "".join(traceback.format_exception(error))
        self._journal.note("failed", what, traceback=text)
        shown = {name: each for name, each in self._fresh() if name != thread}
        found = Deviation(what=what, computer="", since=wall_time())
        self._shown = dict([*shown.items(), (thread, (self._now(), found))][-_MOST:])

    def deviations(self) -> list[Deviation]:
        """Return the last failure of each thread; from any thread."""
        return [deviation for _, (_, deviation) in self._fresh()]

    def _fresh(self) -> list[tuple[str, tuple[float, Deviation]]]:
        since = self._now() - SHOWN_FOR
        return [(name, each) for name, each in self._shown.items() if each[0] >= since]
