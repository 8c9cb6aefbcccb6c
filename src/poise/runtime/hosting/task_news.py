"""What a component tells the manager of tasks; its status carries it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from poise.runtime.component.component import Verb
from poise.wire.records.status import ActionEnd, TaskWish

_MOST_WISHES = 16
"""So many wishes are told again and again, in case nobody heard them."""


class TaskNews:
    """What one component wishes to be done with tasks, and which actions have ended.

    Parameters
    ----------
    on_change
        Called after each; must not block.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._wishes: deque[TaskWish] = deque(maxlen=_MOST_WISHES)
        self._num_wishes = 0
        self._ends: dict[str, ActionEnd] = {}

    def wish(self, verb: Verb, task: str) -> None:
        """Wish that something is done with a task."""
        self._num_wishes += 1
        wish = TaskWish(number=self._num_wishes, verb=verb, task=task)
        self._wishes.append(wish)
        self._on_change()

    def note_end(self, port: str, done: object) -> None:
        """Note that the action of a port is done, or has failed."""
        before = self._ends.get(port)
        count = before.count + 1 if before else 1
        self._ends[port] = ActionEnd(port=port, count=count, done=bool(done))
        self._on_change()

    def wishes(self) -> tuple[TaskWish, ...]:
        """Return the latest, oldest first; any thread may ask."""
        return tuple(self._wishes.copy())

    def ends(self) -> tuple[ActionEnd, ...]:
        """Return the last end at each port; any thread may ask."""
        return tuple(self._ends.copy().values())
