import random

import pytest

from poise.estimate.profiles import (
    distribution_of,
    error_of_mean,
    quantile,
    rolling_means,
)


def test_a_quantile_is_a_value_that_was_seen() -> None:
    """95 of 1 to 100 do not exceed 95."""
    assert quantile(list(range(1, 101)), 0.95) == 95
    assert quantile([3.0, 1.0, 2.0], 0.5) == 2.0
    assert quantile([7.0], 0.99) == 7.0
    assert (quantile([1.0, 2.0], 0.0), quantile([1.0, 2.0], 1.0)) == (1.0, 2.0)


def test_rolling_means_slide_by_one() -> None:
    assert rolling_means([1.0, 2.0, 3.0, 6.0], 2) == [1.5, 2.5, 4.5]
    assert rolling_means([1.0, 3.0], 5) == [2.0]


def test_tells_mean_quantiles_and_peak() -> None:
    """A burst of 1 s in 20 s: ten windows of 100 ms at 0.9 cores, 190 at 0.1.

    Mean (10 * 0.9 + 190 * 0.1) / 200 = 0.14; 5 % of the windows are the burst, so the
    95th percentile is still 0.1. Windows of 2 s hold at most half a burst: 0.5; 29 of
    181 windows touch it, and those that hold all of it are 11, more than 5 %.
    """
    values = [0.1] * 100 + [0.9] * 10 + [0.1] * 90
    distribution = distribution_of(values, 0.1)
    assert distribution.mean == pytest.approx(0.14)
    assert (distribution.p95, distribution.p99, distribution.peak) == (0.1, 0.9, 0.9)
    assert distribution.sustained == pytest.approx(0.5)
    assert distribution.windows == 200


def test_says_nothing_of_no_windows() -> None:
    distribution = distribution_of([])
    assert (distribution.mean, distribution.error, distribution.windows) == (
        0.0,
        None,
        0,
    )


def test_does_not_know_the_error_of_few_windows() -> None:
    assert error_of_mean([1.0, 2.0, 3.0]) is None


def test_error_of_the_mean_by_hand() -> None:
    """Two batches, 1 and 3: variance 2, t 12.71, 12.71 * sqrt(2 / 2)."""
    assert error_of_mean([1.0, 1.0, 3.0, 3.0]) == pytest.approx(12.71)


def test_the_true_mean_lies_within_the_error_19_times_in_20() -> None:
    """Neighbouring windows are alike here, for which a plain interval is too narrow."""
    rng = random.Random(1)
    hits = 0
    for _ in range(400):
        level, values = 0.0, []
        for _ in range(300):
            level = 0.5 * level + rng.gauss(0, 1)
            values.append(5 + level)
        error = error_of_mean(values)
        assert error is not None
        hits += abs(sum(values) / len(values) - 5) <= error
    assert 0.92 <= hits / 400 <= 0.98
