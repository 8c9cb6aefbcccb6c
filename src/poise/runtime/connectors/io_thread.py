"""The thread of a container that sends what is no call and no message.

So neither a component nor the thread that receives messages waits for a socket.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue


class IoThread:
    """Runs short tasks, one after the other; it starts with the first."""

    def __init__(self) -> None:
        self._tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._main, name="io", daemon=True)
        self._starting = threading.Lock()
        self._is_started = False

    def post(self, task: Callable[[], None]) -> None:
        """Run a task soon, on the thread; it must not raise, and ends within 0.2 s."""
        if not self._is_started:
            with self._starting:
                if not self._is_started:
                    self._is_started = True
                    self._thread.start()
        self._tasks.put(task)

    def close(self) -> None:
        """End the thread behind all tasks; harmless when repeated."""
        self._tasks.put(None)

    def _main(self) -> None:
        while (task := self._tasks.get()) is not None:
            task()
