"""The native code of `poise.estimate` in readable Python: its specification."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Sequence
from typing import Literal

SLACK = 0.25
RARITY = 20.0
LEARN = 25
QUICKEST = 2.0
LEFT = 1.0
OUTLIER = 5
_CLIP = 1.5
_BLOCKS = (5, 10)
_KEPT = 150
_SURE = 30

Direction = Literal[-1, 0, 1]


class _Sum:
    """What exceeds the reference and the slack in one direction."""

    def __init__(self, direction: Literal[-1, 1]) -> None:
        self.direction = direction
        self.value = 0.0
        self.windows = 0


class ChangePointDetector:
    """Watches ``value / exposure``, such as CPU time per second or per job.

    Parameters
    ----------
    reference
        What it should be; None: learned from the first 150 windows, and used from the
        first `LEARN` on.
    """

    def __init__(self, reference: float | None = None) -> None:
        self.reference = reference
        self.since = 0
        self._is_given = reference is not None
        self._windows: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._num = 0
        self._learn_at = LEARN
        self._up, self._down = _Sum(1), _Sum(-1)
        self._threshold = math.inf
        self._step = self._largest = self._variance = 0.0

    def update(self, value: float, exposure: float) -> Direction:
        """Take a window; return 1 or -1 when the rate has shifted up or down.

        After a shift the sums start again, with the same reference.

        Parameters
        ----------
        value
            What was counted in the window.
        exposure
            What it is counted per [s, or jobs]; >= 0.
        """
        self._windows.append((value, exposure))
        self._num += 1
        if self._num >= self._learn_at and self._is_calm():
            self._learn()
            # Later it knows much: learning is the dear part of a window.
            self._learn_at = self._num + (LEARN if self._num < _KEPT else _KEPT)
        if self.reference is None or math.isinf(self._threshold):
            return 0
        told = [each for each in (self._up, self._down) if self._add(each)]
        if not told:
            return 0
        self.since = told[0].windows
        self._up, self._down = _Sum(1), _Sum(-1)
        return told[0].direction

    def _excess(self, direction: int, window: tuple[float, float]) -> float:
        """Return what a window adds: no more than the noise that was learned."""
        assert self.reference is not None
        raw = window[0] - self.reference * window[1]
        clipped = max(-self._largest, min(self._largest, raw))
        return direction * clipped - SLACK * self._step

    def _add(self, total: _Sum) -> bool:
        """Add the last window; return whether the rate has shifted that way."""
        excess = self._excess(total.direction, self._windows[-1])
        total.value = max(0.0, total.value + excess)
        total.windows = total.windows + 1 if total.value > 0 else 0
        return total.value > self._threshold and self._stands(total)

    def _stands(self, total: _Sum) -> bool:
        """Whether enough is left without the worst windows that follow each other."""
        if total.windows < 2 * OUTLIER:
            return False
        run = [
            self._excess(total.direction, window)
            for window in list(self._windows)[-total.windows :]
        ]
        starts = range(len(run) - OUTLIER + 1)
        worst = max(sum(run[at : at + OUTLIER]) for at in starts)
        return total.value - worst > LEFT * self._step

    def _is_calm(self) -> bool:
        """Whether no shift is in the making, which would pass for noise."""
        return max(self._up.value, self._down.value) < self._threshold / 4

    def _learn(self) -> None:
        """Fit step and threshold to the windows that are kept."""
        rate = _typical_rate(self._windows)
        if rate <= 0:
            return
        if not self._is_given and self._num <= _KEPT:
            self.reference = rate
        assert self.reference is not None
        noise = [v - rate * e for v, e in self._windows]
        exposure = sum(e for _, e in self._windows)
        self._step = self.reference * exposure / len(noise)
        self._largest = _CLIP * max(self._step, _largest_without_outlier(noise))
        noise = [max(-self._largest, min(self._largest, each)) for each in noise]
        fresh = _variance(noise) * (1 + _SURE / len(noise))
        if self._num > _KEPT:
            # One calm stretch does not make a noisy component a calm one.
            fresh = max(fresh, (fresh + self._variance) / 2)
        self._variance = fresh
        self._threshold = max(
            QUICKEST * self._step,
            fresh * RARITY / (2 * SLACK * self._step),
        )


def _typical_rate(windows: Sequence[tuple[float, float]]) -> float:
    """Return the median of the rates of five stretches: one outlier does not count."""
    size = len(windows) // 5
    kept = list(windows)
    rates = []
    for start in range(0, 5 * size, size):
        part = kept[start : start + size]
        exposure = sum(e for _, e in part)
        rates.append(sum(v for v, _ in part) / exposure if exposure > 0 else 0.0)
    return statistics.median(rates)


def _variance(noise: Sequence[float]) -> float:
    """Return the variance per window that sums over many windows show.

    From blocks: where windows that follow each other are alike it is larger than that
    of single windows, where a burst is followed by a pause it is smaller.
    """
    return max(_variance_of_blocks(noise, size) for size in _BLOCKS)


def _variance_of_blocks(noise: Sequence[float], size: int) -> float:
    starts = range(0, len(noise) - size + 1, size)
    sums = [sum(noise[start : start + size]) for start in starts]
    return sum(each * each for each in sums) / (len(sums) * size)


def _largest_without_outlier(noise: Sequence[float]) -> float:
    """Return the largest, but for those farthest off that follow each other."""
    starts = range(len(noise) - OUTLIER + 1)
    worst = max(starts, key=lambda at: abs(sum(noise[at : at + OUTLIER])))
    others = [*noise[:worst], *noise[worst + OUTLIER :]]
    return max(map(abs, others))
