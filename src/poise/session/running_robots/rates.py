"""How often something came, from the moments at which it did."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from statistics import fmean, pstdev

from msgspec import Struct

from poise.units import format_seconds


class Rate(Struct, frozen=True):
    """How often something came, and how regularly.

    Parameters
    ----------
    count
        How often it came.
    mean
        The rate [Hz]; 0 when it came less than twice.
    shortest, longest
        Time from one to the next [s].
    jitter
        Standard deviation of these times [s].
    missing
        How many more came whose moments are not known.
    """

    count: int = 0
    mean: float = 0.0
    shortest: float = 0.0
    longest: float = 0.0
    jitter: float = 0.0
    missing: int = 0

    @classmethod
    def of(cls, times: Sequence[float], missing: int = 0) -> Rate:
        """Return the rate of what came at these moments [s]."""
        gaps = [later - earlier for earlier, later in pairwise(sorted(times))]
        if not gaps or not sum(gaps):
            return cls(len(times), missing=missing)
        return cls(
            len(times), 1 / fmean(gaps), min(gaps), max(gaps), pstdev(gaps), missing
        )

    def lines(self) -> Iterator[str]:
        """Yield it for people."""
        if not self.mean:
            yield f"{self.count} in this time: no rate"
            return
        shortest, longest, jitter = map(
            format_seconds, (self.shortest, self.longest, self.jitter)
        )
        yield (
            f"{self.mean:.4g} Hz, {shortest} to {longest} apart, jitter {jitter} "
            f"({self.count} times)"
        )
        if self.missing:
            yield f"{self.missing} more had no room to be noted: the rate is higher"
