"""How computers share the host's CPUs."""

from __future__ import annotations

import math

import pytest

from poise.emulate.limits import Limits, share_out, shortages
from poise.errors import RobotError
from poise.model.robot import Computer


def computers(*quotas: float) -> list[Computer]:
    return [
        Computer(name=f"c{number}", capacity={"cpu": quota})
        for number, quota in enumerate(quotas)
    ]


def test_quota_is_capacity_times_speed() -> None:
    (limits,) = share_out(
        [Computer(name="a", capacity={"cpu": 2.0, "memory": 1e9}, speed=0.25)], [0]
    )
    assert limits == Limits(quota=0.5, cpus=(0,), memory=10**9)


def test_each_computer_has_as_many_cpus_of_its_own_as_it_can_fill() -> None:
    found = share_out(computers(0.5, 1.5, 2.0), [2, 3, 4, 5, 6, 7])
    # First one each (2, 3, 4), then what they can fill beyond: 0, 1 and 1.
    assert [limits.cpus for limits in found] == [(2,), (3, 5), (4, 6)]


def test_computers_take_turns_when_there_are_more_than_cpus() -> None:
    found = share_out(computers(0.3, 0.3, 0.3), [0, 1])
    assert [limits.cpus for limits in found] == [(0,), (1,), (0,)]


def test_infinite_memory_is_no_limit() -> None:
    robot = [Computer(name="a", capacity={"cpu": 1.0, "memory": math.inf})]
    assert share_out(robot, [0])[0].memory is None


def test_small_quota_has_a_longer_period() -> None:
    # The kernel hands out 1 ms at least: 0.05 cores need 20 ms.
    assert Limits(quota=0.05, cpus=(0,)).period_us == 20_000
    assert Limits(quota=0.5, cpus=(0,)).period_us == 10_000


@pytest.mark.parametrize("cores", [0.0, 0.0009, -1.0, math.inf])
def test_computer_without_cores_is_refused_by_name(cores: float) -> None:
    with pytest.raises(RobotError, match="'c0' cannot be emulated with"):
        share_out(computers(cores), [0])


def test_what_the_host_is_too_small_for_is_said() -> None:
    large = Limits(quota=4.0, cpus=(0, 1))
    small = Limits(quota=0.6, cpus=(2,))
    assert shortages({"a": small}) == []
    assert shortages({"big": large}) == [
        "'big' asks for 4 host cores and gets 2: it is slower than the robot file says"
    ]
    (sentence,) = shortages({"a": small, "b": small})
    assert "a, b share host CPU 2" in sentence
    assert "ask for 1.2 of it, which is more than it has" in sentence
