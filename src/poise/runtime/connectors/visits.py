"""One thread at a time runs a call chain in a process.

A chain comes into a process by a call over a pipe. When its first thread there waits
for an answer from elsewhere, a second may come in with the same chain: it was called
back. But when a caller gave up and calls again, the first thread still runs: the second
must wait, or two threads would be in one component.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

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


@contextmanager
def visit(chain: int, limit: float) -> Iterator[None]:
    """Run a chain that came in on this thread.

    Raises
    ------
    Timeout
        Another thread ran it all the time, for `limit` [s].
    """
    with _changing:
        visiting = _visits.setdefault(chain, _Visit())
        visiting.num_threads += 1
    try:
        if not visiting.baton.acquire(timeout=limit):
            raise Timeout(f"an earlier call of the same caller ran for {limit:g} s")
        visiting.holder = threading.get_ident()
        try:
            yield
        finally:
            visiting.baton.release()
    finally:
        with _changing:
            visiting.num_threads -= 1
            if not visiting.num_threads:
                del _visits[chain]


@contextmanager
def away(chain: int) -> Iterator[None]:
    """Let the chain come back on another thread, while this one waits elsewhere."""
    visiting = _visits.get(chain)
    me = threading.get_ident()
    if visiting is None or visiting.holder != me:
        yield
        return
    visiting.baton.release()
    try:
        yield
    finally:
        # who was called back runs a component that waits here, and ends in its time
        visiting.baton.acquire()
        visiting.holder = me
