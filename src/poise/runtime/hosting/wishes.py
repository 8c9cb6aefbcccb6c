"""What a component wishes to be done with tasks; its container tells it the manager."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from poise.runtime.component.component import Verb
from poise.wire.records.status import TaskWish

_MOST = 16
"""So many wishes are told again and again, in case nobody heard them."""


class Wishes:
    """The latest wishes of one component, numbered.

    Parameters
    ----------
    on_change
        Called after each; must not block.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._latest: deque[TaskWish] = deque(maxlen=_MOST)
        self._count = 0

    def add(self, verb: Verb, task: str) -> None:
        """Wish that something is done with a task."""
        self._count += 1
        self._latest.append(TaskWish(number=self._count, verb=verb, task=task))
        self._on_change()

    def latest(self) -> tuple[TaskWish, ...]:
        """Return the latest, oldest first; any thread may ask."""
        return tuple(self._latest.copy())
