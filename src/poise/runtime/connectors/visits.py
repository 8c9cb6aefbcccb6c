"""One thread at a time runs a call chain in a process.

A chain comes into a process by a call over a pipe, or begins here. When its first
thread waits for an answer from elsewhere, a second may come in with the same chain: it
was called back. But when a caller gave up, the first thread goes on, or still runs:
whoever comes then must wait, or two threads would be in one component.
"""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self
from weakref import WeakValueDictionary

from poise.errors import Timeout


class _Visit:
    """A chain that is in this process, for as long as a thread keeps this."""

    __slots__ = ("__weakref__", "baton", "holder")

    def __init__(self) -> None:
        self.baton = threading.Lock()
        self.holder = 0

    def take(self, limit: float) -> bool:
        """Become the one that runs, within `limit` [s]; return whether that is so."""
        if not self.baton.acquire(timeout=limit):
            return False
        self.holder = threading.get_ident()
        return True

    def give(self) -> None:
        """Let another thread run."""
        self.holder = 0
        self.baton.release()


class _Begun(threading.local):
    """The last chain that began on a thread and went elsewhere from there.

    It stays that thread's, even when it is over: what comes back then is late.
    """

    visiting: _Visit | None = None


_visits: WeakValueDictionary[int, _Visit] = WeakValueDictionary()
_changing = threading.Lock()
_begun = _Begun()


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
        self._visiting = visiting
        if not visiting.take(self._limit):
            raise Timeout(f"an earlier call of the same caller ran {self._limit:g} s")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._visiting.give()


class away:  # noqa: N801, as above
    """Let the chain come back on another thread, while this one waits elsewhere.

    Parameters
    ----------
    what
        The connector of the call, for errors.

    Raises
    ------
    Timeout
        Who was called back still ran `limit` [s] after the call was over; it runs on.
    """

    __slots__ = ("_chain", "_limit", "_visiting", "_what")

    def __init__(self, chain: int, limit: float, what: str) -> None:
        self._chain = chain
        self._limit = limit
        self._what = what
        self._visiting: _Visit | None = None

    def __enter__(self) -> None:
        visiting = _visits.get(self._chain)
        if visiting is None:
            with _changing:
                visiting = _visits[self._chain] = _begun.visiting = _Visit()
            self._visiting = visiting
        elif visiting.holder == threading.get_ident():
            self._visiting = visiting
            visiting.give()
        elif visiting is _begun.visiting:  # one that was called back has run too long
            self._visiting = visiting

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # who was called back runs a component that waits here
        if self._visiting is not None and not self._visiting.take(self._limit):
            raise Timeout(
                f"connector {self._what}: the call is over, but a call back from it "
                f"still runs after {self._limit:g} s"
            ) from error
