"""The order of priorities gives CPU weights."""

from __future__ import annotations

from poise.manage.deploy.deployment_layout import CpuWeight, cpu_weights
from poise.model.robot import Architecture, Robot


def weights(*priorities: int) -> list[CpuWeight]:
    """Return the weights of architectures with these priorities."""
    architectures = tuple(
        Architecture(name=f"a{i}", function=f"a{i}", priority=priority)
        for i, priority in enumerate(priorities)
    )
    return list(cpu_weights(Robot(name="r", architectures=architectures)).values())


def test_equal_priorities_need_no_weights() -> None:
    assert weights(3, 3) == [CpuWeight(), CpuWeight()]


def test_only_the_order_counts() -> None:
    # nice: 10 times is 1.25 to the power of 10.3
    assert weights(1, 10) == weights(-5, 7) == [CpuWeight(100, 10), CpuWeight(1000, 0)]


def test_three_are_ten_times_apart() -> None:
    assert weights(0, 1, 2, 1) == [
        CpuWeight(100, 19),
        CpuWeight(1000, 10),
        CpuWeight(10000, 0),
        CpuWeight(1000, 10),
    ]


def test_many_keep_the_range_of_the_kernel() -> None:
    found = [each.weight for each in weights(*range(9))]
    assert (found[0], found[-1]) == (100, 10000)
    assert found == sorted(set(found))
