"""Round trips over topics: the handler of an answer sends the next message."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

LIMIT = 30.0


class Ping:
    """Times messages there and back; `send` publishes one."""

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._message: object = None
        self._left = 0
        self._began = 0.0
        self._times: list[float] = []
        self._done = threading.Event()

    def trips(self, message: object, count: int) -> list[float]:
        """Return how long each of `count` round trips took [s]."""
        self._message, self._left, self._times = message, count, []
        self._done.clear()
        self._next()
        if not self._done.wait(LIMIT):
            raise RuntimeError(f"{self._left} answers did not come in {LIMIT} s")
        return self._times

    def on_pong(self) -> None:
        """Take an answer."""
        self._times.append(time.perf_counter() - self._began)
        self._left -= 1
        if self._left:
            self._next()
        else:
            self._done.set()

    def _next(self) -> None:
        self._began = time.perf_counter()
        self._send(self._message)
