"""Functions from basic arithmetic, against those of the standard library."""

from __future__ import annotations

import math
from random import Random
from statistics import NormalDist

import pytest

from poise.simulation._engine import exponential, logarithm, normal_quantile


def test_they_are_those_of_the_standard_library_but_for_the_last_bits() -> None:
    random = Random(1)
    for _ in range(2000):
        x, share = random.uniform(-50.0, 50.0), random.uniform(1e-9, 1 - 1e-9)
        assert exponential(x) == pytest.approx(math.exp(x), rel=2e-15)
        assert logarithm(share) == pytest.approx(math.log(share), rel=1e-15, abs=1e-15)
        quantile = NormalDist().inv_cdf(share)
        assert normal_quantile(share) == pytest.approx(quantile, rel=1e-14, abs=1e-14)


def test_their_bits_are_the_same_on_every_machine() -> None:
    assert exponential(1.0).hex() == "0x1.5bf0a8b14576ap+1"
    assert logarithm(10.0).hex() == "0x1.26bb1bbb55516p+1"
    assert normal_quantile(0.01).hex() == "-0x1.29c5c4630ff0ep+1"


def test_the_tails_are_those_of_the_standard_library() -> None:
    for share in (1e-9, 1e-12, 1e-300):
        quantile = NormalDist().inv_cdf(share)
        assert normal_quantile(share) == pytest.approx(quantile, rel=1e-14)
