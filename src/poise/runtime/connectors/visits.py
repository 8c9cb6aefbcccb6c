"""One thread at a time runs a call chain in a process.

A chain comes into a process by a call over a pipe. When its first thread there waits
for an answer from elsewhere, a second may come in with the same chain: it was called
back. But when a caller gave up and calls again, the first thread still runs: the second
must wait, or two threads would be in one component.
"""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

from poise.errors import Timeout


class _Visit:
    """A chain that is in this process."""

    __slots__ = ("baton", "holder", "num_threads")

    def __init__(self) -> None:
        self.baton = threading.Lock()
        self.holder = 0
        self.num_threads = 0


_visits: dict[int, _Visit] = {}
_changing = threading.Lock()


class visit:  # noqa: N801, it reads as a verb: `with visit(chain, limit)`
    """Run a chain that came in on this thread.

    Raises
    ------
    Timeout
        Another thread ran it all the time, for `limit` [s].
    """

    __slots__ = ("_chain", "_limit", "_visiting")

    def __init__(self, chain: int, limit: float) -> None:
        self._chain = chain
        self._limit = limit

    def __enter__(self) -> Self:
        with _changing:
            visiting = _visits.get(self._chain)
            if visiting is None:
                visiting = _visits[self._chain] = _Visit()
            visiting.num_threads += 1
        self._visiting = visiting
        if not visiting.baton.acquire(timeout=self._limit):
            self._forget()
            raise Timeout(f"an earlier call of the same caller ran {self._limit:g} s")
        visiting.holder = threading.get_ident()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._visiting.baton.release()
        self._forget()

    def _forget(self) -> None:
        with _changing:
            self._visiting.num_threads -= 1
            if not self._visiting.num_threads:
                del _visits[self._chain]


class away:  # noqa: N801, as above
    """Let the chain come back on another thread, while this one waits elsewhere."""

    __slots__ = ("_chain", "_visiting")

    def __init__(self, chain: int) -> None:
        self._chain = chain
        self._visiting: _Visit | None = None

    def __enter__(self) -> None:
        visiting = _visits.get(self._chain)
        if visiting is not None and visiting.holder == threading.get_ident():
            self._visiting = visiting
            visiting.baton.release()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._visiting is not None:
            # who was called back runs a component that waits here, and ends in its time
            self._visiting.baton.acquire()
            self._visiting.holder = threading.get_ident()
