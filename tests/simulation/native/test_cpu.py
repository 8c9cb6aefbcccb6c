"""CPU shares and quotas, against cases solved by hand."""

from __future__ import annotations

import pytest

from poise.simulation._engine import Engine, shares


@pytest.fixture
def engine() -> Engine:
    return Engine(1)


@pytest.mark.parametrize(
    ("cores", "claims", "expected"),
    [
        # three equal ones share two cores
        (2.0, [(100, 1), (100, 1), (100, 1)], [2 / 3, 2 / 3, 2 / 3]),
        # the first needs 0.2 only; of the 1.8 left 3/4 would be 1.35, which is over 1
        (2.0, [(100, 0.2), (300, 1), (100, 1)], [0.2, 1.0, 0.8]),
        # ten times the weight, but it needs half a core only
        (1.0, [(100, 1), (1000, 0.5)], [0.5, 0.5]),
        # by weights: 1 to 3
        (1.0, [(100, 1), (300, 1)], [0.25, 0.75]),
        # no one wants anything
        (1.0, [(100, 0), (300, 0)], [0.0, 0.0]),
    ],
)
def test_shares_by_weight_and_leaves_to_others_what_one_does_not_need(
    cores: float, claims: list[tuple[float, float]], expected: list[float]
) -> None:
    assert shares(cores, claims) == pytest.approx(expected)


def test_equal_work_of_unequal_weights_ends_one_after_the_other(
    engine: Engine,
) -> None:
    cpu = engine.cpu(1.0)
    light, heavy = cpu.group(100), cpu.group(300)
    light.run(0.3)
    heavy.run(0.3)
    # heavy has 3/4 of the core: 0.3 / 0.75 = 0.4 s; light has done 0.1 by then, and
    # the 0.2 that are left take the whole core
    engine.run(0.4)
    assert (light.used, heavy.used) == pytest.approx((0.1, 0.3))
    engine.run(0.5)
    assert (light.used, heavy.used) == pytest.approx((0.2, 0.3))
    engine.run(5.0)
    assert cpu.used() == pytest.approx(0.6)


def test_two_threads_of_one_interpreter_share_one_core(engine: Engine) -> None:
    group = engine.cpu(4.0).group()
    for _ in range(2):
        group.run(0.1)
    engine.run(0.1)
    assert group.used == pytest.approx(0.1)
    engine.run(5.0)
    assert group.used == pytest.approx(0.2)


def test_a_quota_lets_it_run_at_full_speed_and_then_stand(engine: Engine) -> None:
    group = engine.cpu(1.0).group(quota=0.3)
    group.run(0.07)
    # 0.03 until 0.03 s, 0.03 more from 0.1 to 0.13 s, 0.01 from 0.2 to 0.21 s; a cap
    # of the rate would end at 0.23 s
    for at, used in ((0.03, 0.03), (0.1, 0.03), (0.13, 0.06), (0.205, 0.065)):
        engine.run(at)
        assert group.used == pytest.approx(used)
    engine.run(0.21)
    assert group.used == pytest.approx(0.07)
    assert group.throttled == 2


def test_what_is_paused_leaves_its_share_to_others(engine: Engine) -> None:
    cpu = engine.cpu(1.0)
    stopped, other = cpu.group(), cpu.group()
    stopped.run(0.5)
    other.run(0.5)
    engine.run(0.2)
    stopped.pause()
    # each has 0.1 at 0.2 s; the other does its 0.4 alone until 0.6 s
    engine.run(0.6)
    assert (stopped.used, other.used) == pytest.approx((0.1, 0.5))
    engine.run(2.0)
    stopped.pause(is_paused=False)
    engine.run(2.2)
    assert stopped.used == pytest.approx(0.3)


def test_what_ends_takes_its_work_along(engine: Engine) -> None:
    cpu = engine.cpu(1.0)
    gone, other = cpu.group(), cpu.group()
    gone.run(1.0)
    other.run(0.5)
    engine.run(0.2)
    gone.end()
    engine.run(0.6)  # 0.1 until 0.2 s, then 0.4 alone
    assert (gone.used, other.used) == pytest.approx((0.1, 0.5))
    assert cpu.used() == pytest.approx(0.6)


def test_a_slow_computer_takes_longer_for_the_same_work(engine: Engine) -> None:
    group = engine.cpu(1.0, speed=0.5).group()
    group.run(0.1)
    engine.run(0.1)
    assert group.used == pytest.approx(0.05)
    engine.run(5.0)
    assert group.used == pytest.approx(0.1)


def test_an_emulated_computer_runs_quickly_and_then_stands(engine: Engine) -> None:
    """It has 3 of each 10 ms, which the kernel looks at every 4 ms.

    So it takes 4 ms, has 2 of the next period, and ends 7 ms of work in the third.
    """
    cpu = engine.cpu(1.0, speed=0.3, is_emulated=True)
    group, other = cpu.group(), cpu.group()
    group.run(0.007)
    for until, used in (
        (0.002, 0.002),
        (0.009, 0.004),
        (0.011, 0.005),
        (0.019, 0.006),
        (0.03, 0.007),
    ):
        engine.run(until)
        assert group.used == pytest.approx(used)
    group.run(0.005)
    other.run(0.005)  # they share 1 ms of the last period, 3 of this one, 2 too many
    engine.run(0.039)
    assert (group.used, other.used) == pytest.approx((0.01, 0.003))
