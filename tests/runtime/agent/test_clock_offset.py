import random

import pytest

from poise.clock import DRIFT
from poise.runtime.agent.heartbeat_exchange import ClockOffset


def test_a_symmetric_trip_by_hand() -> None:
    """The other clock is 100 s ahead; 2 ms there, 1 ms of work, 2 ms back.

    The bounds are 99.998 (t2 - t3) and 100.002 (t1 - t0).
    """
    clock = ClockOffset()
    clock.add(5.0, 105.002, 105.003, 5.005)
    offset = clock.at(5.005)
    assert offset is not None
    assert offset.offset == pytest.approx(100)
    assert offset.error == pytest.approx(0.002, abs=1e-6)  # 5 ms of drift
    assert offset.trip == pytest.approx(0.004)
    assert offset.at == 5.005


def test_knows_nothing_before_a_round_trip() -> None:
    clock = ClockOffset()
    assert clock.at(0.0) is None


def test_the_quickest_ways_there_and_back_bound_it() -> None:
    """One trip is quick only there (1 ms), the other only back (1 ms): +- 1 ms."""
    clock = ClockOffset()
    clock.add(0.0, 50.001, 50.001, 0.101)
    clock.add(0.2, 50.3, 50.3, 0.301)
    offset = clock.at(0.301)
    assert offset is not None
    assert offset.offset == pytest.approx(50, abs=1e-5)
    assert offset.error == pytest.approx(0.001, abs=2e-5)


def test_the_truth_is_always_within_the_error() -> None:
    """With ways of any length, and a clock that runs 20e-6 s/s fast."""
    rng = random.Random(3)
    clock, now = ClockOffset(), 0.0
    for _ in range(500):
        now += rng.random()
        there, work, back = (rng.expovariate(200) + 1e-4 for _ in range(3))
        truth = 7.0 + 20e-6 * now
        arrived, left = now + there, now + there + work
        returned = left + back
        clock.add(now, arrived + truth, left + truth, returned)
        offset = clock.at(returned)
        assert offset is not None
        assert abs(offset.offset - (7.0 + 20e-6 * returned)) <= offset.error + 1e-9
        now = returned
    assert offset is not None
    assert offset.error < 0.002


def test_grows_less_sure_with_time() -> None:
    clock = ClockOffset()
    clock.add(0.0, 1.0, 1.0, 0.0)
    offset = clock.at(100.0)
    assert offset is not None
    assert offset.error == pytest.approx(100 * DRIFT)


def test_forgets_what_was_before_a_clock_was_set() -> None:
    clock = ClockOffset()
    clock.add(0.0, 10.0, 10.0, 0.001)
    clock.add(1.0, 3601.0, 3601.0, 1.001)
    offset = clock.at(1.001)
    assert offset is not None
    assert offset.offset == pytest.approx(3600, abs=0.001)


def test_passes_over_times_that_contradict_each_other() -> None:
    clock = ClockOffset()
    clock.add(1.0, 5.0, 4.0, 2.0)
    clock.add(2.0, 5.0, 5.0, 1.0)
    assert clock.at(2.0) is None


def test_knows_nothing_when_trips_that_overtook_each_other_contradict_all() -> None:
    """The trip that began later came first; then the other's clock was set by 100 s."""
    clock = ClockOffset()
    clock.add(5.0, 105.0, 105.0, 5.01)  # 99.99 s to 100 s ahead
    clock.add(3.0, 203.0, 203.0, 5.02)  # 197.98 s to 200 s ahead
    assert clock.at(5.1) is None


def test_forgets_a_trip_that_overtook_and_contradicts_a_later_one() -> None:
    """It is neither the first that is known nor the last."""
    clock = ClockOffset()
    clock.add(5.0, 105.0, 105.0, 5.01)
    clock.add(3.0, 203.0, 203.0, 5.02)
    clock.add(6.0, 106.0, 106.0, 6.01)
    offset = clock.at(6.01)
    assert offset is not None
    assert offset.offset == pytest.approx(100, abs=0.01)
