"""What is believed of a success rate, against values worked out by hand."""

from random import Random

import pytest

from poise.estimate.success import Posterior


def test_knows_nothing_before_the_first_outcome() -> None:
    """Uniform over [0, 1]: mean 1/2, deviation sqrt(1/12)."""
    prior = Posterior()
    assert prior.mean == 0.5
    assert prior.deviation == pytest.approx((1 / 12) ** 0.5)
    assert prior.interval(0.9) == pytest.approx((0.05, 0.95))


def test_learns_from_outcomes() -> None:
    """Beta(3, 2) after 2 of 3: mean 3/5, variance 1/25, F(x) = 4 x^3 - 3 x^4."""
    posterior = Posterior(done=2, failed=1)
    assert posterior.mean == pytest.approx(3 / 5)
    assert posterior.deviation == pytest.approx(1 / 5)
    assert posterior.below(0.5) == pytest.approx(4 / 8 - 3 / 16)
    low, high = posterior.interval(0.5)
    assert posterior.below(low) == pytest.approx(0.25)
    assert posterior.below(high) == pytest.approx(0.75)


def test_is_sure_after_many_outcomes() -> None:
    """Of 1,000 the interval is 1.645 deviations on each side, as of a normal."""
    posterior = Posterior(done=500, failed=500)
    low, high = posterior.interval(0.9)
    assert high - low == pytest.approx(2 * 1.645 * posterior.deviation, rel=5e-3)


def test_draws_as_it_believes() -> None:
    """The mean of 10,000 draws is within 5 standard errors, and a seed repeats it."""
    posterior = Posterior(done=8, failed=1)
    random = Random(1)
    draws = [posterior.sample(random) for _ in range(10_000)]
    error = posterior.deviation / 100
    assert sum(draws) / 10_000 == pytest.approx(posterior.mean, abs=5 * error)
    assert draws[0] == posterior.sample(Random(1))
