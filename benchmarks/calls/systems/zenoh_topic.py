"""zenoh alone: a put and a subscriber in each direction, over TCP on loopback.

It imports internal modules: it opens the session that agents use.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zenoh

from benchmarks.calls.ping import Ping
from benchmarks.calls.timing import Trips, payload, read
from benchmarks.calls.zenoh_pair import ADDRESS, wait_matching
from poise.wire.control_session import open_session


def publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Return one with the settings that Poise uses."""
    return session.declare_publisher(
        key, congestion_control=zenoh.CongestionControl.BLOCK, express=True
    )


def serve(_folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    session = open_session(listen=[ADDRESS])
    pong = publisher(session, "bench/pong")
    session.declare_subscriber(
        "bench/ping", lambda sample: pong.put(sample.payload.to_bytes())
    )
    ready()
    threading.Event().wait()


@contextmanager
def connect(_folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    session = open_session(connect=[ADDRESS])
    out = publisher(session, "bench/ping")
    ping = Ping(out.put)

    def on_pong(sample: zenoh.Sample) -> None:
        read(sample.payload.to_bytes())
        ping.on_pong()

    session.declare_subscriber("bench/pong", on_pong)
    wait_matching(out)
    yield lambda size, count: ping.trips(payload(size), count)
