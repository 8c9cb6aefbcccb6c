"""What waits for a component's thread: messages, by port, each queue bounded."""

from __future__ import annotations

import threading
import time
from collections import deque
from queue import Empty, SimpleQueue
from typing import Any

from poise.errors import Timeout
from poise.runtime.connectors.counts import Counts
from poise.runtime.ports import Queue

Entry = tuple[int, Any]
"""A waiting message or one-way call: its tag, and the message or the arguments."""


class Inbox:
    """The queue of one port, filled by any thread, emptied by the component's."""

    def __init__(self, port: str, queue: Queue) -> None:
        self.port = port
        self.arrived = 0
        self._queue = queue
        self._waiting: deque[tuple[Entry, Counts, float]] = deque()
        self._changed = threading.Condition()
        self._spare = 0
        self._is_resting = False

    def add(self, entry: Entry, limit: float, counts: Counts) -> bool:
        """Queue a message; return whether the number of waiting ones grew.

        `counts` are its connector's: they learn when it is dropped, or how long it
        waited.

        Raises
        ------
        Timeout
            The queue blocks and was full for `limit` [s]; the message is not in it.
        """
        with self._changed:
            self.arrived += 1
            grew = True
            if not self._has_room():
                if self._queue.policy == "block":
                    self._wait_for_room(limit)
                else:
                    _, older, _ = self._waiting.popleft()
                    older.drops += 1
                    grew = False
            self._waiting.append((entry, counts, time.monotonic()))
            return grew

    def take(self) -> Entry | None:
        """Return the oldest message; None when there is none."""
        with self._changed:
            if not self._waiting:
                return None
            self._spare = max(0, self._spare - 1)
            self._changed.notify()
            entry, counts, came = self._waiting.popleft()
            counts.wait.add(time.monotonic() - came)
            return entry

    def rest(self, *, resting: bool) -> None:
        """Drop nothing and let nobody wait while the component is at rest."""
        with self._changed:
            self._is_resting = resting
            self._spare = len(self._waiting)
            self._changed.notify_all()

    def waiting(self) -> list[Entry]:
        """Return what waits, oldest first."""
        with self._changed:
            return [entry for entry, _, _ in self._waiting]

    def _has_room(self) -> bool:
        # what came while at rest has room of its own until it is taken
        return self._is_resting or len(self._waiting) < self._queue.size + self._spare

    def _wait_for_room(self, limit: float) -> None:
        if not self._changed.wait_for(self._has_room, limit):
            raise Timeout(
                f"port '{self.port}' had {self._queue.size} messages waiting for "
                f"{limit:g} s"
            )


class Mailbox:
    """Wakes a component's thread, once for every message, in the order they came.

    It holds one entry per waiting message, and the queues are bounded.
    """

    def __init__(self) -> None:
        self._filled: SimpleQueue[Inbox | None] = SimpleQueue()

    def add(self, inbox: Inbox, entry: Entry, limit: float, counts: Counts) -> None:
        """Queue a message for the component; `Inbox.add` says when it raises."""
        if inbox.add(entry, limit, counts):
            self._filled.put(inbox)

    def wake(self) -> None:
        """Let `next` return."""
        self._filled.put(None)

    def next(self, limit: float | None) -> Inbox | None:
        """Wait up to `limit` [s] for a queue with a message; None when none came."""
        try:
            return self._filled.get(timeout=limit)
        except Empty:
            return None
