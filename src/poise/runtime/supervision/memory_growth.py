"""Notices leaks: memory that grows all the time.

It grows when it does so from each fifth of a time to the next, and beyond all that it
was within the minute before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import combinations, pairwise
from statistics import mean, median

READ_EVERY = 1.0
"""Memory is read this often [s]."""
_FIFTH = 3
"""Readings in each fifth of the time that is looked at."""
_ALL = 5 * _FIFTH
_COARSE = 4
"""What grows in lumps is seen over a longer time, with every fourth reading."""
_CONFIRMED = 3
"""It begins to grow, or ceases, when as many readings in succession say so."""
_PART = 0.6
"""From each fifth to the next it grows by at least this part of the mean growth."""
_BEFORE = 60.0
"""It must exceed all that it was within this time before [s]."""
_LEAST = 64 * 1024.0
"""Slower growth is none [bytes/s]."""


class MemoryGrowth:
    """Follows the memory of one container."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._read_at = float("-inf")
        self._count = self._unlike = 0
        self._fine, self._coarse = _Trend(READ_EVERY), _Trend(_COARSE * READ_EVERY)

    def is_due(self, now: float) -> bool:
        """Return whether the memory should be read at `now` [s]."""
        return now - self._read_at >= READ_EVERY

    def update(self, now: float, size: float) -> None:
        """Add a reading [bytes] that was due at `now` [s]."""
        self._read_at = now
        self._fine.add(now, size)
        if self._count % _COARSE == 0:
            self._coarse.add(now, size)
        self._count += 1
        rate = self._fine.rate() or self._coarse.rate()
        self._unlike = 0 if bool(rate) == bool(self.rate) else self._unlike + 1
        if self._unlike == 0 or self._unlike >= _CONFIRMED:
            self.rate, self._unlike = rate, 0


class _Trend:
    """The last readings, one each `every` seconds."""

    def __init__(self, every: float) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=_ALL)
        self._before: deque[float] = deque(maxlen=round(_BEFORE / every))

    def add(self, now: float, size: float) -> None:
        if len(self._last) == _ALL:
            self._before.append(self._last[0][1])
        self._last.append((now, size))

    def rate(self) -> float:
        """Return the growth [bytes/s]: the median of the slopes of all pairs."""
        if len(self._last) < _ALL:
            return 0.0
        readings = list(self._last)
        if not _grows([size for _, size in readings], max(self._before, default=0.0)):
            return 0.0
        pairs = combinations(readings, 2)
        rate = median((b - a) / (later - at) for (at, a), (later, b) in pairs)
        return rate if rate >= _LEAST else 0.0


def _grows(sizes: Sequence[float], highest: float) -> bool:
    """Return whether each fifth is higher than the one before, and than `highest`."""
    starts = range(0, len(sizes), _FIFTH)
    levels = [median(sizes[at : at + _FIFTH]) for at in starts]
    steps = [after - before for before, after in pairwise(levels)]
    steady = min(steps) > 0 and min(steps) >= _PART * mean(steps)
    return steady and levels[-1] > highest
