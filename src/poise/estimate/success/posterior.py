"""What is believed of a success rate after some outcomes: a Beta distribution."""

from __future__ import annotations

from math import exp, fsum, lgamma, log, log1p, sqrt
from random import Random

from msgspec import Struct

_STEPS = 40
"""Halvings of an interval: far below what is shown."""


class Posterior(Struct, frozen=True):
    """The belief about a success rate, from the uniform prior Beta(1, 1).

    It is Beta(1 + `done`, 1 + `failed`), the conjugate of independent outcomes of one
    rate (Agrawal and Goyal 2012, algorithm 1).

    Parameters
    ----------
    done, failed
        How many outcomes there were of each kind.
    """

    done: int = 0
    failed: int = 0

    @property
    def count(self) -> int:
        """How many outcomes it is learned from."""
        return self.done + self.failed

    @property
    def mean(self) -> float:
        """The expected success rate, in (0, 1)."""
        return (self.done + 1) / (self.count + 2)

    @property
    def deviation(self) -> float:
        """The standard deviation of the success rate."""
        return sqrt(self.mean * (1 - self.mean) / (self.count + 3))

    def interval(self, share: float = 0.9) -> tuple[float, float]:
        """Return the limits between which the rate is with this probability.

        As much lies below the lower limit as above the upper one.
        """
        return self._quantile((1 - share) / 2), self._quantile((1 + share) / 2)

    def sample(self, random: Random) -> float:
        """Return a rate drawn from the belief, as Thompson sampling does; above 0."""
        return max(random.betavariate(self.done + 1, self.failed + 1), 1e-9)

    def below(self, rate: float) -> float:
        """Return the probability that the success rate is at most `rate`.

        With whole parameters this is a tail of the binomial distribution.
        """
        if not 0 < rate < 1:
            return float(rate >= 1)
        n = self.count + 1
        ways, hit, miss = lgamma(n + 1), log(rate), log1p(-rate)
        return fsum(
            exp(ways - lgamma(k + 1) - lgamma(n - k + 1) + k * hit + (n - k) * miss)
            for k in range(self.done + 1, n + 1)
        )

    def _quantile(self, probability: float) -> float:
        low, high = 0.0, 1.0
        for _ in range(_STEPS):
            middle = (low + high) / 2
            if self.below(middle) < probability:
                low = middle
            else:
                high = middle
        return (low + high) / 2
