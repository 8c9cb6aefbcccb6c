"""A tick whose parts fail one by one: what one raises ends none of the others.

An exception is journalled with its traceback and is a deviation until the part works
again. Only that part backs off. No bug of Poise ends a robot.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable

from poise.clock import Clock, wall_time
from poise.errors import PoiseError, TakenOver
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation

FIRST_PAUSE = 1.0
"""A part that raised is left out for this time [s]; twice as long each time."""
LONGEST_PAUSE = 60.0


class _Failure:
    """A part that raised when it was run last."""

    def __init__(self, what: str, pause: float, again_at: float, since: float) -> None:
        self.what = what
        self.pause = pause
        self.again_at = again_at
        self.since = since


class SupervisedTick:
    """Runs the parts of one loop; for the thread of that loop."""

    def __init__(
        self,
        journal: Journal,
        clock: Clock,
        on_bug: Callable[[str], object] = lambda _: None,
        is_ending: Callable[[], bool] = lambda: False,
    ) -> None:
        self._journal = journal
        self._clock = clock
        self._on_bug = on_bug
        self._is_ending = is_ending
        self._failures: dict[str, _Failure] = {}

    def run(
        self, part: str, work: Callable[[], object], *, changes: bool = False
    ) -> object:
        """Run a part, unless it backs off; return what it returns, or None."""
        if self.backs_off(part):
            return None
        try:
            result = work()
        except TakenOver:
            raise
        except Exception as error:  # noqa: BLE001, no bug of Poise ends a robot
            if not (isinstance(error, PoiseError) and self._is_ending()):
                self._note(part, error, changes=changes)
            return None
        if self._failures.pop(part, None) is not None:
            self._journal.note("right", f"the manager can {part} again")
        return result

    def backs_off(self, part: str) -> bool:
        """Return whether a part raised, and is not tried again yet."""
        failure = self._failures.get(part)
        return failure is not None and self._clock.now() < failure.again_at

    def deviations(self) -> list[Deviation]:
        """Return what does not work now; from any thread."""
        return [
            Deviation(what=each.what, computer="", since=each.since)
            for each in list(self._failures.values())
        ]

    def _note(self, part: str, error: Exception, *, changes: bool) -> None:
        before = self._failures.get(part)
        pause = min(2 * before.pause, LONGEST_PAUSE) if before else FIRST_PAUSE
        is_bug = not isinstance(error, PoiseError)
        said = f"{type(error).__name__}: {error}" if is_bug else str(error)
        why = "a bug of Poise, please report it" if is_bug else "it is tried again"
        what = f"the manager cannot {part} ({said}): {why}; all else goes on"
        since = before.since if before else wall_time()
        again_at = self._clock.now() + pause
        self._failures[part] = _Failure(what, pause, again_at, since)
        text = f"{what}; the next try is in {pause:g} s"
        self._journal.note("failed", text, traceback=traceback.format_exc())
        if is_bug and changes:
            self._on_bug(what)
