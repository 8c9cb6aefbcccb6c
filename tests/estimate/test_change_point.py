"""The laws of change detection, proved by simulation with fixed seeds."""

import random
from collections.abc import Callable, Iterator

import pytest

from poise.estimate._change_point import LEARN, OUTLIER, ChangePointDetector
from tests.estimate import reference

STEP = 0.2
TEN_MINUTES = round(600 / STEP)
Noise = Callable[[random.Random], Iterator[float]]


def normal(spread: float) -> Noise:
    def loads(rng: random.Random) -> Iterator[float]:
        while True:
            yield max(0.0, rng.gauss(1, spread))

    return loads


def waves(rng: random.Random) -> Iterator[float]:
    """Windows that follow each other are alike."""
    level = 0.0
    while True:
        level = 0.6 * level + 0.1 * rng.gauss(0, 1)
        yield max(0.0, 1 + level)


def bursts(rng: random.Random) -> Iterator[float]:
    """Give a job every half second, which windows of 0.2 s see or do not see."""
    phase, count = rng.random() / 2, 0
    for k in range(1 << 30):
        seen = int((k * STEP + phase) * 2)
        yield (seen - count) * 2.5 * rng.gauss(1, 0.05)
        count = seen


def outliers(rng: random.Random) -> Iterator[float]:
    """Steady but for single windows ten times as large, once in two minutes."""
    while True:
        yield rng.gauss(1, 0.05) + (10 if rng.random() < STEP / 120 else 0)


def hiccups(rng: random.Random) -> Iterator[float]:
    """Steady but for single windows up to five times as large, once a minute."""
    while True:
        hiccup = rng.uniform(1, 4) if rng.random() < STEP / 60 else 0.0
        yield rng.gauss(1, 0.05) + hiccup


def slow_seconds(rng: random.Random) -> Iterator[float]:
    """All that is done within a second takes twice as long, every half minute."""
    begins = rng.randrange(100)
    for k in range(1 << 30):
        yield rng.gauss(1, 0.05) * (2 if (k + begins) % 150 < OUTLIER else 1)


NOISES = [normal(0.05), normal(0.2), waves, bursts]
DISTURBED = [outliers, hiccups, slow_seconds]


def shifts(noise: Noise, seed: int, num: int, at: int, factor: float) -> list[int]:
    """Return the windows in which a shift was told."""
    shift, loads = ChangePointDetector(), noise(random.Random(seed))
    told = []
    for index in range(num):
        load = 0.1 * next(loads) * (factor if index >= at else 1)
        if shift.update(load * STEP, STEP):
            told.append(index)
    return told


@pytest.mark.slow
@pytest.mark.parametrize("noise", [*NOISES, *DISTURBED])
def test_tells_no_shift_in_ten_minutes_of_steady_load(noise: Noise) -> None:
    for seed in range(15):
        assert shifts(noise, seed, TEN_MINUTES, TEN_MINUTES, 1.0) == []


@pytest.mark.slow
@pytest.mark.parametrize("noise", [normal(0.05), bursts])
def test_finds_a_shift_by_half_within_three_seconds(noise: Noise) -> None:
    for seed in range(30):
        told = shifts(noise, seed, 300, 200, 1.5)
        assert told
        assert 200 <= told[0] <= 200 + 3 / STEP


@pytest.mark.slow
def test_finds_it_in_noise_too_mostly_within_three_seconds() -> None:
    """Windows that vary by a fifth: the median delay is under 3 s, the longest 10 s."""
    delays = sorted(
        (shifts(normal(0.2), seed, 400, 200, 1.5)[0] - 199) * STEP for seed in range(40)
    )
    assert delays[20] <= 3
    assert delays[-1] <= 10


@pytest.mark.parametrize(("factor", "direction"), [(2.0, 1), (0.4, -1)])
def test_tells_the_direction(factor: float, direction: int) -> None:
    shift = ChangePointDetector()
    for _ in range(LEARN):
        assert shift.update(1.0, 1.0) == 0
    told = {shift.update(factor, 1.0) for _ in range(20)}
    assert told == {0, direction}


@pytest.mark.parametrize("factor", [3.0, 100.0])
def test_what_is_over_within_a_second_is_no_shift(factor: float) -> None:
    shift = ChangePointDetector()
    for index in range(200):
        is_outlier = 100 <= index < 100 + OUTLIER
        assert shift.update(factor if is_outlier else 1.0, 1.0) == 0


def test_says_when_the_shift_began() -> None:
    """It is told 10 windows after it, when 2.5 windows' worth have added up."""
    shift = ChangePointDetector()
    for _ in range(100):
        assert shift.update(1.0, 1.0) == 0
    told = [shift.update(1.5, 1.0) for _ in range(10)]
    assert told == [0] * 9 + [1]
    assert shift.since == 10


def test_a_shift_by_less_than_the_slack_is_none() -> None:
    assert shifts(normal(0.05), 1, 1000, 200, 1.15) == []


def test_compares_with_the_reference_that_is_given() -> None:
    """It needs twice what it should from the first window on."""
    shift = ChangePointDetector(reference=0.1)
    told = [shift.update(0.2, 1.0) for _ in range(LEARN + 10)]
    assert 1 in told


def test_says_nothing_where_nothing_is_used() -> None:
    shift = ChangePointDetector()
    assert {shift.update(0.0, 1.0) for _ in range(200)} == {0}


@pytest.mark.parametrize("noise", [*NOISES, *DISTURBED])
@pytest.mark.parametrize("given", [None, 0.1])
def test_agrees_with_the_reference(noise: Noise, given: float | None) -> None:
    """Through learning, a shift up, one down, and windows without exposure."""
    native, readable = ChangePointDetector(given), reference.ChangePointDetector(given)
    loads = noise(random.Random(7))
    for index in range(600):
        factor = 2.0 if 250 <= index < 400 else 1.0
        value = 0.02 * factor * next(loads)
        exposure = 0.0 if index % 50 == 49 else 0.2
        assert native.update(value, exposure) == readable.update(value, exposure)
        assert native.reference == pytest.approx(readable.reference)
