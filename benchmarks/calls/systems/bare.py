"""A method of another Python object: nothing in between."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path

from benchmarks.calls.timing import Trips

BATCH = 100


class Callee:
    """Has the method."""

    def echo(self, data: bytes) -> bytes:
        """Return what came."""
        return data


class Caller:
    """Calls it as a component would: ``self.port.method(x)``."""

    def __init__(self, port: Callee) -> None:
        self.port = port

    def trips(self, size: int, count: int) -> list[float]:
        """Time batches, because one call is shorter than reading the clock."""
        data, times = bytes(size), []
        for _ in range(count):
            began = time.perf_counter()
            for _ in repeat(None, BATCH):
                self.port.echo(data)
            times.append((time.perf_counter() - began) / BATCH)
        return times


@contextmanager
def connect(_folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    yield Caller(Callee()).trips
