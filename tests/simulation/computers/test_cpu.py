"""CPU shares and quotas, against cases solved by hand."""

from __future__ import annotations

from functools import partial

import pytest

from poise.simulation.computers.cpu import Cpu, CpuClaim, shares
from poise.simulation.schedule.scheduler import Scheduler


@pytest.fixture(autouse=True)
def _never_idle(scheduler: Scheduler) -> None:
    scheduler.at(1e6, lambda: None)


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
    given = shares(cores, [CpuClaim(weight, most) for weight, most in claims])
    assert given == pytest.approx(expected)


def test_equal_work_of_unequal_weights_ends_one_after_the_other(
    scheduler: Scheduler,
) -> None:
    cpu, ends = Cpu(scheduler, 1.0), dict[str, float]()
    for name, weight in (("light", 100), ("heavy", 300)):
        cpu.group(weight).run(0.3, partial(_note, ends, name, scheduler))
    scheduler.run(5.0)
    # heavy has 3/4 of the core: 0.3 / 0.75 = 0.4 s; light has done 0.1 by then, and
    # the 0.2 that are left take the whole core
    assert ends == {"heavy": pytest.approx(0.4), "light": pytest.approx(0.6)}


def test_two_threads_of_one_interpreter_share_one_core(scheduler: Scheduler) -> None:
    group, ends = Cpu(scheduler, 4.0).group(), list[float]()
    for _ in range(2):
        group.run(0.1, lambda: ends.append(scheduler.now))
    scheduler.run(5.0)
    assert ends == [pytest.approx(0.2)] * 2


def test_a_quota_lets_it_run_at_full_speed_and_then_stand(scheduler: Scheduler) -> None:
    group, ends = Cpu(scheduler, 1.0).group(quota=0.3), list[float]()
    group.run(0.07, lambda: ends.append(scheduler.now))
    scheduler.run(5.0)
    # 0.03 until 0.03 s, 0.03 more from 0.1 to 0.13 s, 0.01 from 0.2 to 0.21 s; a cap
    # of the rate would end at 0.23 s
    assert ends == [pytest.approx(0.21)]
    assert group.throttled == 2
    assert group.used == pytest.approx(0.07)


def test_what_is_paused_leaves_its_share_to_others(scheduler: Scheduler) -> None:
    cpu, ends = Cpu(scheduler, 1.0), dict[str, float]()
    stopped, other = cpu.group(), cpu.group()
    for name, group in (("stopped", stopped), ("other", other)):
        group.run(0.5, partial(_note, ends, name, scheduler))
    scheduler.at(0.2, stopped.pause)
    scheduler.at(2.0, lambda: stopped.pause(is_paused=False))
    scheduler.run(5.0)
    # each has 0.1 at 0.2 s; the other does its 0.4 alone until 0.6 s, the stopped one
    # its 0.4 from 2 s on
    assert ends == {"other": pytest.approx(0.6), "stopped": pytest.approx(2.4)}


def test_what_ends_takes_its_work_along(scheduler: Scheduler) -> None:
    cpu, ends = Cpu(scheduler, 1.0), list[float]()
    gone, other = cpu.group(), cpu.group()
    gone.run(1.0, lambda: ends.append(-1.0))
    other.run(0.5, lambda: ends.append(scheduler.now))
    scheduler.at(0.2, gone.end)
    scheduler.run(5.0)
    assert ends == [pytest.approx(0.6)]  # 0.1 until 0.2 s, then 0.4 alone


def _note(ends: dict[str, float], name: str, scheduler: Scheduler) -> None:
    ends[name] = scheduler.now
