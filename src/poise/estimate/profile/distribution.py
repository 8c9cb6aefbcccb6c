"""The distribution of a measurement over windows: mean, error, quantiles, peak."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

WINDOW = 0.1
"""CPU is measured over windows of this length [s]."""
SUSTAINED = 2.0
"""[s] A computer must provide the demand over windows of this length. Shorter bursts of
components on one computer rarely coincide."""
BATCHES = 10
# Student's t for a two-sided 95 % interval and 1, 2, ... degrees of freedom
_T95 = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)


class Distribution(Struct, frozen=True, kw_only=True):
    """A measurement over windows of `WINDOW`, in its own unit (cores, for CPU).

    Parameters
    ----------
    sustained
        The 95th percentile over windows of `SUSTAINED`.
    error
        Half the width of the mean's 95 % confidence interval; None for too few windows.
    windows
        How many there were.
    """

    mean: float = 0.0
    p95: float = 0.0
    p99: float = 0.0
    peak: float = 0.0
    sustained: float = 0.0
    error: float | None = None
    windows: int = 0


def quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that at least `share` of `values` do not exceed.

    Parameters
    ----------
    values
        At least one.
    share
        In [0, 1].
    """
    ordered = sorted(values)
    # share * n of 0.95 * 20 is 19.000000000000004 in floating point
    rank = math.ceil(share * len(ordered) - 1e-9)
    return ordered[max(rank, 1) - 1]


def error_of_mean(values: Sequence[float]) -> float | None:
    """Return half the width of the 95 % confidence interval of a series' mean.

    Neighbouring windows are correlated, so the series is cut into `BATCHES` batches,
    whose means are nearly independent (method of batch means). None for fewer than four
    values.
    """
    num = min(BATCHES, len(values) // 2)
    if num <= 1:
        return None
    size = len(values) // num
    means = [sum(values[i * size : (i + 1) * size]) / size for i in range(num)]
    centre = sum(means) / num
    variance = sum((mean - centre) ** 2 for mean in means) / (num - 1)
    return _T95[num - 2] * math.sqrt(variance / num)


def distribution_of(values: Sequence[float], window: float = WINDOW) -> Distribution:
    """Return the distribution of a series over windows of equal length.

    Parameters
    ----------
    values
        One per window, oldest first.
    window
        Length of a window [s]; > 0.
    """
    if not values:
        return Distribution()
    return Distribution(
        mean=sum(values) / len(values),
        p95=quantile(values, 0.95),
        p99=quantile(values, 0.99),
        peak=max(values),
        sustained=quantile(rolling_means(values, round(SUSTAINED / window)), 0.95),
        error=error_of_mean(values),
        windows=len(values),
    )


def rolling_means(values: Sequence[float], size: int) -> list[float]:
    """Return the mean of every `size` values that follow each other.

    The mean of all when there are fewer.
    """
    size = max(1, min(size, len(values)))
    total = sum(values[:size])
    means = [total / size]
    for last, first in zip(values[size:], values, strict=False):
        total += last - first
        means.append(total / size)
    return means
