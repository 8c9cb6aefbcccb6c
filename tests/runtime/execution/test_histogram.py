"""The native histogram does what the one in Python does."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.runtime._calls import Histogram
from poise.wire.records.status_records import Summary
from tests.runtime import reference

VALUES = st.lists(st.floats(min_value=-1.0, max_value=1e30, allow_nan=False))


@given(VALUES)
def test_agrees_with_the_reference(values: list[float]) -> None:
    native, readable = Histogram(), reference.Histogram()
    for value in values:
        native.add(value)
        readable.add(value)
    ours, theirs = native.summary(), readable.summary()
    assert (ours.count, ours.maximum) == (theirs.count, theirs.maximum)
    assert ours.mean == pytest.approx(theirs.mean)
    # a value on the border of two buckets may be rounded into either
    assert ours.median == pytest.approx(theirs.median, rel=0.1)
    assert ours.p99 == pytest.approx(theirs.p99, rel=0.1)


@given(st.lists(st.floats(1e-8, 1e6), min_size=1))
def test_its_quantiles_are_right_within_five_percent(values: list[float]) -> None:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    exact = sorted(values)[math.ceil(len(values) * 0.5) - 1]
    assert histogram.summary().median == pytest.approx(exact, rel=0.05)


@given(st.floats(1e-8, 1e6), st.integers(1, 9))
def test_equal_values_are_their_own_quantiles(value: float, count: int) -> None:
    histogram = Histogram()
    for _ in range(count):
        histogram.add(value)
    summary = histogram.summary()
    assert (summary.median, summary.p99) == (value, value)


def test_is_all_zero_when_empty() -> None:
    assert Histogram().summary() == Summary()


def test_counts_what_is_no_delay_as_zero() -> None:
    histogram = Histogram()
    for value in (-1.0, math.nan, 0.0):
        histogram.add(value)
    assert histogram.summary() == Summary(count=3)


def test_survives_infinity() -> None:
    histogram = Histogram()
    histogram.add(math.inf)
    assert histogram.summary().maximum == math.inf
