"""pyzmq: REQ/REP over ipc."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zmq

from benchmarks.calls.timing import Trips, payload, read, timed


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    replier = zmq.Context().socket(zmq.REP)
    replier.bind(f"ipc://{folder}/s")
    ready()
    while True:
        replier.send(replier.recv(copy=False), copy=False)


@contextmanager
def connect(folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    requester = zmq.Context().socket(zmq.REQ)
    requester.connect(f"ipc://{folder}/s")

    def echo(data: bytes) -> None:
        requester.send(data, copy=False)
        read(requester.recv(copy=False))

    yield lambda size, count: timed(echo, payload(size), count)
