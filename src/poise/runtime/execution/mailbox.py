"""The messages that wait for a component's thread, by port, in bounded queues."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from math import inf
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from poise.errors import UsageError, unknown
from poise.runtime._calls import ComponentCounters
from poise.runtime.component.ports import Queue
from poise.runtime.execution.counters import Counts

log = logging.getLogger(__name__)

Entry = tuple[int, Any]
"""A waiting message or one-way call: its tag, and the message or the arguments."""
MOST_AHEAD = 5_000
"""Messages that one connector may bring without room: a source may buffer as many while
the component moves, and then send them at once."""


Work = tuple[str, Callable[[], object]]
"""What there is to do, and the code of the component that does it."""


class WorkSource(Protocol):
    """Where a component's thread gets work from besides its ports."""

    def wait(self, limit: float | None) -> Work | None:
        """Wait up to `limit` [s] for work, or until `wake`; on its own thread."""

    def wake(self) -> None:
        """Let `wait` return, now or when it is called next; from any thread."""


class Feed:
    """One connector's way into the queue of a port, with room of its own."""

    def __init__(self, inbox: PortQueue, counts: Counts) -> None:
        self.counts = counts
        self.waiting = 0
        self.on_room: Callable[[], None] = lambda: None
        self._inbox = inbox
        self.half = max(1, inbox.queue.size // 2)

    def put(self, entry: Entry) -> None:
        """Queue a message for the component; one without room is counted."""
        self._inbox.add(entry, self)

    def has_room(self) -> bool:
        """Return whether a message would find room."""
        return self.room() != 0

    def room(self) -> int | None:
        """Return for how many messages there is room; None: for all."""
        inbox = self._inbox
        if inbox.queue.policy == "keep":
            return None
        # a paused component takes nothing, and may itself wait for this source
        waiting = 0 if inbox.is_unbounded else self.waiting
        return max(0, inbox.queue.size - waiting)


class PortQueue:
    """The queue of one port, filled by any thread, emptied by the component's."""

    def __init__(
        self,
        port: str,
        queue: Queue,
        offer: Callable[[PortQueue], object],
        counters: ComponentCounters,
    ) -> None:
        self.port = port
        self.queue = queue
        self._offer = offer
        self._counters = counters
        self._waiting: deque[tuple[Entry, Feed, float]] = deque()
        self._changing = threading.Lock()
        self._while_paused = 0
        self.is_unbounded = self.is_closed = False
        self.last_came: float | None = None

    def add(self, entry: Entry, feed: Feed) -> None:
        """Queue a message for the component; one without room is counted."""
        with self._changing:
            grows = True
            if self.is_closed:
                feed.counts.drops += 1
                return
            self._counters.note_asked()
            if self.queue.policy == "block":
                if feed.waiting >= self.queue.size + MOST_AHEAD:
                    feed.counts.drops += 1
                    if not self.is_unbounded:
                        text = "port '%s': its source ignores back-pressure: %s"
                        log.warning(text, self.port, "a message is dropped")
                    return
            elif self._is_full():
                _, oldest, _ = self._waiting.popleft()
                oldest.waiting -= 1
                oldest.counts.drops += 1
                grows = False
            feed.waiting += 1
            self.last_came = time.monotonic()
            self._waiting.append((entry, feed, self.last_came))
        if grows:
            self._offer(self)

    def pop(self) -> Entry | None:
        """Return the oldest message; None when there is none."""
        with self._changing:
            if not self._waiting:
                return None
            self._while_paused = max(0, self._while_paused - 1)
            entry, feed, came = self._waiting.popleft()
            feed.waiting -= 1
        feed.counts.wait.add(time.monotonic() - came)
        feed.on_room()
        return entry

    def set_unbounded(self, *, unbounded: bool) -> None:
        """Drop nothing and let nobody wait while the component is paused."""
        with self._changing:
            self.is_unbounded = unbounded
            self._while_paused = len(self._waiting)
            feeds = {feed for _, feed, _ in self._waiting}
        if unbounded:
            for feed in feeds:
                feed.on_room()

    def close(self) -> set[Feed]:
        """Drop and count what waits, and all that comes; return whose it was."""
        with self._changing:
            self.is_closed = True
            feeds = [feed for _, feed, _ in self._waiting]
            self._waiting.clear()
            for feed in feeds:
                feed.waiting -= 1
                feed.counts.drops += 1
        return set(feeds)

    def waiting(self) -> list[Entry]:
        """Return what waits, oldest first."""
        with self._changing:
            return [entry for entry, _, _ in self._waiting]

    def _is_full(self) -> bool:
        # what came while it was paused has room of its own until it is taken
        return (
            not self.is_unbounded
            and len(self._waiting) >= self.queue.size + self._while_paused
        )


class Mailbox:
    """All that waits for a component, which takes it in the order in which it came."""

    def __init__(
        self, queues: Mapping[str, Queue], counters: ComponentCounters
    ) -> None:
        self._filled: SimpleQueue[PortQueue | None] = SimpleQueue()
        self._source: WorkSource | None = None
        self._inboxes = {
            port: PortQueue(port, queue, self.offer, counters)
            for port, queue in queues.items()
        }
        self._bounding = threading.Lock()
        self._is_unbounded = False

    def feed(self, port: str, counts: Counts, /) -> Feed:
        """Return the way into a port's queue for the connector of `counts`."""
        return Feed(self._inboxes[port], counts)

    def age(self, port: str, /) -> float:
        """Return how long ago a message came at a port last [s]; inf: none has."""
        inbox = self._inboxes.get(port)
        if inbox is None:
            raise UsageError(unknown("subscribed port", port, self._inboxes))
        came = inbox.last_came
        return inf if came is None else time.monotonic() - came

    def preload(self, port: str, entry: Entry) -> None:
        """Queue what waited for the incarnation before; called before `activate`."""
        self._inboxes[port].set_unbounded(unbounded=True)
        self.feed(port, Counts()).put(entry)

    def waiting(self) -> Iterator[tuple[str, Entry]]:
        """Yield what waits, with its port; for each port the oldest first."""
        for port, inbox in self._inboxes.items():
            for entry in inbox.waiting():
                yield port, entry

    def is_empty(self) -> bool:
        """Return whether no message and no one-way call waits."""
        return next(self.waiting(), None) is None

    def close(self) -> None:
        """Take nothing any more, and make nobody wait: the component has failed."""
        for inbox in self._inboxes.values():
            for feed in inbox.close():
                feed.on_room()

    def hold_up_nobody(self) -> None:
        """Make no source wait while the component is not active."""
        for inbox in self._inboxes.values():
            inbox.is_unbounded = inbox.queue.policy == "block"

    def set_unbounded(self, *, unbounded: bool) -> None:
        """Lift the bounds of all queues while nothing is taken out, or restore them."""
        with self._bounding:
            self._is_unbounded = unbounded
            self._set_unbounded(unbounded=unbounded)

    @contextmanager
    def with_room(self) -> Iterator[None]:
        """Lift the bounds of all queues for a moment."""
        with self._bounding:
            self._set_unbounded(unbounded=True)
        try:
            yield
        finally:
            with self._bounding:
                self._set_unbounded(unbounded=self._is_unbounded)

    def offer(self, inbox: PortQueue | None) -> None:
        """Let `work` return a queue that has a message; None: just return."""
        self._filled.put(inbox)
        if self._source is not None:
            self._source.wake()

    def wake(self) -> None:
        """Let `work` return."""
        self.offer(None)

    def listen(self, source: WorkSource | None) -> None:
        """Let `work` come from a source, too; None: no more."""
        self._source = source

    def work(self, limit: float | None) -> PortQueue | Work | None:
        """Wait up to `limit` [s] for a queue with a message, or for the source."""
        source = self._source
        if source is not None and self._filled.empty():
            return source.wait(limit)
        try:
            return self._filled.get(timeout=limit)
        except Empty:
            return None

    def _set_unbounded(self, *, unbounded: bool) -> None:
        for inbox in self._inboxes.values():
            inbox.set_unbounded(unbounded=unbounded)
