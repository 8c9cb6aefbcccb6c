"""Counts values of either sign, with quantiles right within 5 %."""

from __future__ import annotations

from math import inf

from poise.runtime._calls import Histogram
from poise.wire.records.status_records import Summary


class SignedHistogram:
    """A histogram of what is below 0, mirrored, and one of all else."""

    def __init__(self) -> None:
        self._below, self._above = Histogram(), Histogram()
        self._maximum = -inf

    def add(self, value: float) -> None:
        """Count one value; what is no number (NaN) counts as 0."""
        (self._below if value < 0 else self._above).add(abs(value))
        self._maximum = max(self._maximum, value)

    def summary(self) -> Summary:
        """Return what is known of all values; mean and maximum are exact."""
        below, above = self._below.summary(), self._above.summary()
        if not below.count:
            return above
        count = below.count + above.count
        return Summary(
            count=count,
            mean=(above.count * above.mean - below.count * below.mean) / count,
            median=self._quantile(0.5, below.count, above.count),
            p99=self._quantile(0.99, below.count, above.count),
            maximum=self._maximum,
        )

    def _quantile(self, share: float, below: int, above: int) -> float:
        rank = share * (below + above)
        if rank <= below:
            return -self._below.quantile(1 - rank / below)
        return self._above.quantile((rank - below) / above)
