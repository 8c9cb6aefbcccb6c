"""Balancers of other systems place as their rules say."""

from __future__ import annotations

import pytest

import poise
from benchmarks.experiment.balancers import Choice, balanced, least_allocated
from poise.plan import Item

ROBOT = "examples/trot/robot.yaml"


def choice(cpu: float, memory: float, **free: tuple[float, float]) -> Choice:
    return Choice(
        Item(name="it", demand={"cpu": cpu, "memory": memory}),
        tuple(free),
        {name: {"cpu": c, "memory": m} for name, (c, m) in free.items()},
        {name: {"cpu": 1.0, "memory": 1.0} for name in free},
    )


def test_kubernetes_takes_the_emptier_and_the_more_balanced_node() -> None:
    assert least_allocated(choice(0.1, 0.1, full=(0.3, 0.3), empty=(0.9, 0.9))) == (
        "empty"
    )
    # as much is free in all; with it one has .4 and .4 left, the other .8 and 0
    assert least_allocated(choice(0.1, 0.1, even=(0.5, 0.5), odd=(0.9, 0.1))) == "even"


def test_kubernetes_takes_no_node_that_the_requests_do_not_fit_on() -> None:
    assert least_allocated(choice(0.5, 0.1, small=(0.4, 1.0), large=(0.6, 0.2))) == (
        "large"
    )


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("rule", ["least-allocated", "least-loaded"])
def test_a_balancer_places_all_that_static_does_where_it_may_run(rule: str) -> None:
    robot = poise.load(ROBOT)
    static = poise.place(robot, "serve", method="static")
    where = balanced(robot, "serve", rule)
    assert where.keys() == static.where.keys()
    allowed = {item.name: item.only for item in static.result.problem.components}
    assert all(not allowed[n] or at in allowed[n] for n, at in where.items())
    assert set(where.values()) == {"main", "vision"}
