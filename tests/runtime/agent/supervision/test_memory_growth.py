"""What is a leak, and what is not; one reading a second, in MB."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable

import pytest

from poise.runtime.supervision.sampler import MemoryGrowth

MB = 1e6
START = 100 * MB


def rates(seconds: Iterable[int], memory: Callable[[int], float]) -> list[float]:
    """Return the growth after each reading [MB/s]."""
    growth, found = MemoryGrowth(), []
    for now in seconds:
        growth.update(float(now), memory(now))
        found.append(growth.rate / MB)
    return found


def test_a_steady_leak_is_known_after_17_s() -> None:
    found = rates(range(60), lambda now: START + 2 * MB * now)
    assert found[:16] == [0.0] * 16
    assert found[16:] == pytest.approx([2.0] * 44)


def test_a_noisy_leak_is_known_with_its_slope() -> None:
    rng = random.Random(1)
    noise = [rng.gauss(0, 0.3 * MB) for _ in range(60)]
    found = rates(range(60), lambda now: START + 2 * MB * now + noise[now])
    assert found[-1] == pytest.approx(2.0, rel=0.2)
    assert all(found[20:])


def test_a_leak_in_lumps_is_known_with_its_slope() -> None:
    """30 MB every 10 s: seen over a minute."""
    found = rates(range(120), lambda now: START + 30 * MB * (now // 10))
    assert found[-1] == pytest.approx(3.0, rel=0.3)


@pytest.mark.parametrize("lasts", [1, 4, 8])
def test_what_is_allocated_once_is_no_leak(lasts: int) -> None:
    """500 MB at once, or at the start, or within some seconds."""
    for begins in (0, 30):
        found = rates(
            range(120),
            lambda now, begins=begins: (
                START  # type: ignore[misc]
                + 500 * MB * min(1.0, max(0.0, (now - begins) / lasts))
            ),
        )
        assert not any(found)


def test_steps_that_are_far_apart_are_no_leak() -> None:
    found = rates(range(200), lambda now: START + 50 * MB * (now // 40))
    assert not any(found)


@pytest.mark.parametrize("period", [3, 7, 10])
def test_what_a_garbage_collector_gives_back_is_no_leak(period: int) -> None:
    found = rates(range(200), lambda now: START + 20 * MB * (now % period))
    assert not any(found)


def test_a_slow_garbage_collector_is_no_leak_once_it_has_collected() -> None:
    """It gives back every 30 s: before the first time, nobody can tell."""
    found = rates(range(200), lambda now: START + 5 * MB * (now % 30))
    assert not any(found[34:])


def test_noise_is_no_leak() -> None:
    rng = random.Random(2)
    found = rates(range(2000), lambda _: START + rng.gauss(0, 3 * MB))
    assert sum(rate > 0 for rate in found) < 10
    assert not any(rate > 1.0 for rate in found)


def test_what_approaches_a_size_is_no_leak_any_more() -> None:
    found = rates(range(200), lambda now: START + 200 * MB * (1 - math.exp(-now / 5)))
    assert not any(found[60:])


def test_a_leak_that_ends_is_none_within_some_seconds() -> None:
    found = rates(range(60), lambda now: START + 2 * MB * min(now, 30))
    assert found[30] > 0
    assert not any(found[40:])
