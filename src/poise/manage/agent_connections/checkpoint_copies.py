"""The copies of components' checkpoints that a manager keeps, one for each."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from msgspec import structs

from poise.wire.records.checkpoints import CheckpointCopy


class CheckpointCopies:
    """The last checkpoint of each component, as its agent sent it. Any thread may ask.

    Parameters
    ----------
    clock
        Returns the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._copies: dict[str, tuple[CheckpointCopy, float]] = {}

    def note(self, copy: CheckpointCopy) -> None:
        """Keep a copy; one without data says that the one before still holds."""
        now = self._clock()
        with self._lock:
            before, _ = self._copies.get(copy.component, (copy, now))
            if before.epoch > copy.epoch:
                return
            if copy.data is None:
                if before.data is None or before.epoch != copy.epoch:
                    return
                copy = structs.replace(copy, data=before.data)
            self._copies[copy.component] = copy, now

    def get(self, component: str, epoch: int) -> CheckpointCopy | None:
        """Return the last state of an incarnation, with its age now, if it is known."""
        with self._lock:
            copy, at = self._copies.get(component, (None, 0.0))
        if copy is None or copy.epoch != epoch:
            return None
        return structs.replace(copy, age=copy.age + self._clock() - at)
