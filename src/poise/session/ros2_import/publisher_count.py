"""Counts what comes from one publisher, and the stamps in it; pure."""

from __future__ import annotations

from collections import deque
from statistics import quantiles
from typing import Literal

from poise.session.ros2_import.graph_records import Age, Flow

_OLDEST = 60.0
"""[s] Stamps that are older, or from the future, are of another clock."""
_LAST = 400
_FEW = 3


class PublisherCount:
    """What came from one publisher.

    Messages have sequence numbers, so the rate counts those of the pauses, too.
    """

    def __init__(self) -> None:
        self.received = 0
        self._bytes = 0
        self._first = self._last = (0, 0)
        self._ages: deque[float] = deque(maxlen=_LAST)
        self.stamps: deque[int] = deque(maxlen=_LAST)

    def count(self, size: int, number: int, sent: int) -> None:
        """Count a message: its size, its number and when it was sent [ns]."""
        self._last = (number, sent)
        self._first = self._first if self.received else self._last
        self.received += 1
        self._bytes += size

    def count_stamp(self, stamp: int, now: int) -> None:
        """Count the stamp of a message that arrived `now` [ns]."""
        self.stamps.append(stamp)
        if 0 <= now - stamp <= _OLDEST * 1e9:
            self._ages.append((now - stamp) / 1e9)

    def flow(self, node: str, seconds: float) -> Flow:
        """Return what was measured in `seconds`."""
        messages = self._last[0] - self._first[0]
        elapsed = (self._last[1] - self._first[1]) / 1e9
        exact = messages >= _FEW and elapsed > 0
        return Flow(
            node=node,
            rate=messages / elapsed if exact else self.received / seconds,
            size=self._bytes / self.received,
            age=self._age(),
            stamps=tuple(self.stamps),
        )

    def _age(self) -> Age | None:
        if len(self._ages) < _FEW:
            return None
        hundredths = quantiles(self._ages, n=100, method="inclusive")
        return Age(hundredths[49], hundredths[98])


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] with which a serialized message (CDR) begins."""
    order: Literal["little", "big"] = "little" if data[1] & 1 else "big"
    seconds = int.from_bytes(data[4:8], order, signed=True)
    return seconds * 1_000_000_000 + int.from_bytes(data[8:12], order)
