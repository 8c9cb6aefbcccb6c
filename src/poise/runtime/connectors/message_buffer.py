"""What a sender holds back while its target moves, or its source is not active yet."""

from __future__ import annotations

from collections import deque
from typing import Any

from poise.runtime.connectors.interface import Method
from poise.runtime.execution.connector_counters import Counts

MOST_BUFFERED = 5_000
"""Messages that a sender buffers while a component moves; then publishers wait."""

Waiting = tuple[Method | None, Any, float]
"""A one-way call's method, what is sent, and since when it waits [s, monotonic]."""


class MessageBuffer:
    """Messages and one-way calls, oldest first. Its sender holds a lock meanwhile."""

    def __init__(self, counts: Counts) -> None:
        self._counts = counts
        self._waiting: deque[Waiting] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def has_room(self) -> bool:
        """Return whether one more may be added."""
        return len(self) < MOST_BUFFERED

    def add(self, waiting: Waiting) -> None:
        """Add the newest."""
        self._counts.drops += len(self) == self._waiting.maxlen
        self._waiting.append(waiting)

    def take(self) -> Waiting:
        """Remove the oldest and return it; there must be one."""
        return self._waiting.popleft()

    def keep(self, most: int | None) -> None:
        """Hold only the newest messages from now on; None: all, as before."""
        if most is not None:
            self._counts.drops += max(0, len(self) - most)
            self._waiting = deque(self._waiting, most)
