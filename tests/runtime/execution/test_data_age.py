"""How old data is when a component of a chain uses it, by hand-made times."""

from __future__ import annotations

from math import isnan, nan

import pytest

from poise.runtime.execution.data_age import DataAges, Stamped, with_stamps
from poise.testing import VirtualClock
from poise.wire.codec import WireError, codec
from poise.wire.records.deployment_records import ChainPart

FIRST = ChainPart(name="c", is_first=True)
WITHIN = ChainPart(name="c")
LAST = ChainPart(name="c", deadline=0.1)


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(100.0)


def came(*stamps: float) -> Stamped:
    return Stamped(["c"] * len(stamps), stamps, None)


def test_the_first_component_stamps_what_it_sends(clock: VirtualClock) -> None:
    ages = DataAges([FIRST], clock)
    assert ages.stamps(["c"]) == (100.0,)
    assert ages.status() == ()


def test_the_last_one_uses_data_at_the_end_of_the_run(clock: VirtualClock) -> None:
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.05], taken=came(99.97))
    (status,) = ages.status()
    assert (status.age.count, status.missed) == (1, 0)
    assert status.age.maximum == pytest.approx(0.08)


def test_data_beyond_its_deadline_is_counted(clock: VirtualClock) -> None:
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.05], taken=came(99.9))
    assert ages.status()[0].missed == 1


def test_what_an_answer_brought_is_used_in_its_turn(clock: VirtualClock) -> None:
    """What a run took before is no part of it."""
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.0], taken=came(99.0))
    ages.note(["c"], [99.98])  # on the thread of the call
    ages.run(clock.sleep, [0.0], is_later=True)
    (status,) = ages.status()
    assert (status.age.count, status.missed) == (2, 1)
    assert status.age.mean == pytest.approx((1.0 + 0.02) / 2)


def test_a_timer_uses_what_came_last_again_and_again(clock: VirtualClock) -> None:
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.0], is_later=True)
    assert ages.status()[0].age.count == 0  # nothing came yet
    ages.run(clock.sleep, [0.0], taken=came(99.99))
    for _ in range(2):
        clock.sleep(0.1)
        ages.run(clock.sleep, [0.0], is_later=True)
    (status,) = ages.status()
    assert (status.age.count, status.missed) == (3, 2)
    assert status.age.maximum == pytest.approx(0.21)


def test_a_run_that_took_nothing_uses_nothing(clock: VirtualClock) -> None:
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.0], taken=came(100.0))
    ages.run(clock.sleep, [5.0])
    assert ages.status()[0].age.count == 1


def test_an_error_is_no_use(clock: VirtualClock) -> None:
    ages = DataAges([LAST], clock)
    with pytest.raises(ValueError, match="no number"):
        ages.run(_fail, [], taken=came(100.0))
    assert ages.status()[0].age.count == 0


def _fail() -> None:
    raise ValueError("no number")


def test_of_several_inputs_of_one_run_the_oldest_goes_on(clock: VirtualClock) -> None:
    ages = DataAges([WITHIN], clock)
    ages.run(lambda: ages.note(["c"], [99.5]), [], taken=came(99.9))
    assert ages.stamps(["c"]) == (99.5,)
    ages.run(lambda: ages.note(["c"], [99.8]), [], taken=came(99.6))
    assert ages.stamps(["c"]) == (99.6,)


def test_one_within_a_chain_uses_data_when_it_sends_it_on(clock: VirtualClock) -> None:
    ages = DataAges([WITHIN], clock)
    ages.run(clock.sleep, [0.5], taken=came(99.9))
    assert ages.status()[0].age.count == 0
    ages.stamps(["c"])
    assert ages.status()[0].age.maximum == pytest.approx(0.6)


@pytest.mark.parametrize("stamps", [(nan,), (99.0, nan), (nan, 99.0)])
def test_an_age_that_nobody_knows_is_not_counted(
    clock: VirtualClock, stamps: tuple[float, ...]
) -> None:
    ages = DataAges([LAST], clock)
    ages.run(clock.sleep, [0.0], taken=came(*stamps))
    assert ages.status()[0].age.count == 0


def test_a_chain_that_is_not_ones_own_has_no_stamp(clock: VirtualClock) -> None:
    ages = DataAges([], clock)
    ages.note(["c"], [1.0])
    assert isnan(ages.stamps(["c"])[0])
    assert not ages


def test_a_successor_goes_on_with_what_came_last(clock: VirtualClock) -> None:
    old, new = DataAges([LAST], clock), DataAges([LAST], clock)
    old.run(clock.sleep, [0.0], taken=came(99.0))
    new.restore(old.held())
    new.run(clock.sleep, [0.0], is_later=True)
    assert new.status()[0].age.maximum == pytest.approx(1.0)


def test_other_stamps_than_those_of_the_chains_are_refused() -> None:
    def sent(*stamps: float) -> bytes:
        chains = [str(stamp) for stamp in stamps]
        return with_stamps(codec(int), chains).encode((stamps, 7))[0]

    taken = with_stamps(codec(int), ["c"])
    assert taken.decode(sent(1.0), memoryview(b"")) == ((1.0,), 7)
    for stamps in ((), (1.0, 2.0)):
        with pytest.raises(WireError, match="length 1"):
            taken.decode(sent(*stamps), memoryview(b""))
