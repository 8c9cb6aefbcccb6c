"""Statistics of values of either sign."""

from __future__ import annotations

from random import Random
from statistics import fmean, median

import pytest

from poise.runtime.execution.counters import SignedHistogram


@pytest.mark.parametrize("middle", [-30.0, -1.0, 0.0, 2.0, 50.0])
def test_counts_errors_of_either_sign(middle: float) -> None:
    random, counted = Random(3), SignedHistogram()
    values = [random.gauss(middle, 10.0) for _ in range(2_000)]
    for value in values:
        counted.add(value)
    found = counted.summary()
    assert found.count == len(values)
    assert found.mean == pytest.approx(fmean(values))
    assert found.maximum == max(values)
    assert found.median == pytest.approx(median(values), rel=0.06, abs=0.1)
    assert found.p99 == pytest.approx(sorted(values)[1980], rel=0.06, abs=0.3)


def test_all_may_be_below_zero() -> None:
    counted = SignedHistogram()
    for value in (-4.0, -2.0, -1.0):
        counted.add(value)
    found = counted.summary()
    assert found.mean == pytest.approx(-7 / 3)
    assert found.median == pytest.approx(-2.0, rel=0.06)
    assert found.maximum == -1.0
