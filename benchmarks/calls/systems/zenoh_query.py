"""zenoh alone: a declared querier and a queryable, over TCP on loopback.

It imports internal modules: it opens the session that agents use.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zenoh

from benchmarks.calls.timing import Trips, payload, read, timed
from benchmarks.calls.zenoh_pair import ADDRESS, wait_matching
from poise.wire.control_session import open_session

KEY = "bench/call"


def serve(_folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    session = open_session(listen=[ADDRESS])

    def answer(query: zenoh.Query) -> None:
        assert query.payload is not None
        query.reply(KEY, query.payload.to_bytes())

    session.declare_queryable(KEY, answer)
    ready()
    threading.Event().wait()


@contextmanager
def connect(_folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    session = open_session(connect=[ADDRESS])
    querier = session.declare_querier(KEY, timeout=10, express=True)
    wait_matching(querier)

    def echo(data: bytes) -> None:
        for reply in querier.get(payload=data):
            assert reply.ok is not None
            read(reply.ok.payload.to_bytes())

    yield lambda size, count: timed(echo, payload(size), count)
