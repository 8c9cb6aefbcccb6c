"""Counts what is under way at one end of a pipe, so that its end waits for it."""

from __future__ import annotations

import threading
from typing import Self


class UnderWay:
    """Calls that have begun and not ended. Enter it as a context manager for each."""

    def __init__(self) -> None:
        self._num = 0
        self._changed = threading.Condition()

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def begin(self) -> None:
        """Count one more."""
        with self._changed:
            self._num += 1

    def end(self) -> None:
        """Count one less."""
        with self._changed:
            self._num -= 1
            self._changed.notify_all()

    def wait_none(self, limit: float) -> bool:
        """Wait up to `limit` [s] until none is; return whether that is so."""
        with self._changed:
            return self._changed.wait_for(lambda: self._num == 0, limit)
