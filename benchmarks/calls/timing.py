"""How round trips are timed and told."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import repeat
from statistics import median, quantiles
from typing import Any

import numpy as np
from msgspec import Struct

Trips = Callable[[int, int], Sequence[float]]
"""Takes a payload's size [B] and a number of round trips; returns their times [s]."""


BIG = 1 << 16
"""Payloads of so many bytes and more are sent as arrays, and read [bytes]."""


class Times(Struct, frozen=True):
    """Round trips of one payload: their median and 99th percentile [us]."""

    size: int
    median_us: float
    p99_us: float


def payload(size: int) -> bytes:
    """Return `size` bytes in memory of their own: zeros would share one page."""
    return b"\x01" * size


def read(data: Any) -> None:
    """Read all of a large payload, as who waited for it would."""
    if memoryview(data).nbytes >= BIG:
        np.frombuffer(data, np.uint64).max()


def timed(call: Callable[[Any], object], argument: object, count: int) -> list[float]:
    """Return how long each of `count` calls took [s]."""
    times = []
    now = time.perf_counter
    for _ in repeat(None, count):
        began = now()
        call(argument)
        times.append(now() - began)
    return times


def times_of(size: int, durations: Sequence[float]) -> Times:
    """Summarise durations [s]."""
    p99 = quantiles(durations, n=100)[-1]
    return Times(size, round(median(durations) * 1e6, 3), round(p99 * 1e6, 3))


def measure(trips: Trips, size: int, count: int) -> Times:
    """Time `count` round trips, after some to warm up."""
    trips(size, max(3, count // 10))
    return times_of(size, trips(size, count))
