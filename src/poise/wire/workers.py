"""Threads that work on what comes in over a connector."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Workers(Generic[T]):
    """At most `most` threads that take items from `source` until it ends.

    Another is started when all are busy, so that one that waits in a call does not keep
    others, such as those of the same chain, from coming in. The thread that takes an
    item works on it: a hand-over to another thread costs more than the work itself.
    """

    def __init__(
        self, source: Iterator[T], work: Callable[[T], None], most: int
    ) -> None:
        self._source = source
        self._work = work
        self._most = most
        self._lock = threading.Lock()
        self._num = self._idle = 0
        self._start_one()

    def _start_one(self) -> None:
        self._num += 1
        self._idle += 1
        threading.Thread(target=self._main, name="remote", daemon=True).start()

    def _main(self) -> None:
        for item in self._source:
            with self._lock:
                self._idle -= 1
                if not self._idle and self._num < self._most:
                    self._start_one()
            self._work(item)
            del item  # it may hold a call open, and this thread waits now
            with self._lock:
                self._idle += 1
