"""A planner is built once: other demands and pins change what it decides."""

import pytest

from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError
from poise.plan import Planner, Problem


def test_decides_like_solve() -> None:
    problem = random_robot(1, 24, 2)
    planner = Planner(problem)
    for method in ("greedy", "auto", "search"):
        first = planner.decide(method, steps=20_000)
        second = plan.solve(problem, method=method, steps=20_000)
        assert first.placement == second.placement
        assert first.objective == second.objective
        assert first.proven == second.proven


def test_new_demands_give_what_a_new_problem_gives() -> None:
    before, after = random_robot(1, 24, 2), random_robot(2, 24, 2)
    demands = {c.name: dict(c.demand) for c in after.components}
    planner = Planner(before)
    planner.update(demands)
    anew = Planner(planner.problem)
    assert [c.demand for c in planner.problem.components] == [*demands.values()]
    for method in ("greedy", "auto"):
        assert planner.decide(method).placement == anew.decide(method).placement


def test_an_earlier_result_keeps_its_demands(two_computers: Problem) -> None:
    planner = Planner(two_computers)
    result = planner.decide("greedy")
    planner.update({"a": {"cpu": 0.0}, "b": {"cpu": 0.0}})
    expected = plan.solve(two_computers, method="greedy").objective
    assert result.objective == expected
    assert planner.decide("greedy").objective != expected


def test_components_that_share_a_computer_are_updated_together(
    two_computers: Problem,
) -> None:
    """A and b together need 5 of the larger computer's 4 cores."""
    planner = Planner(
        Problem(
            components=two_computers.components,
            computers=two_computers.computers,
            together=(("a", "b"),),
        )
    )
    planner.update({"a": {"cpu": 3.0}, "b": {"cpu": 2.0}})
    assert not planner.decide().feasible


@pytest.mark.parametrize(
    ("demands", "message"),
    [
        ({"x": {"cpu": 1.0}}, "no component is called 'x'"),
        ({"a": {"gpu": 1.0}}, "no resource is called 'gpu'"),
        ({"a": {"cpu": -1.0}}, "demand of 'cpu' is -1.0"),
        ({"b": {"cpu": 9.0}, "a": {"cpu": float("nan")}}, "demand of 'cpu' is nan"),
    ],
)
def test_refuses_what_is_no_demand_and_changes_nothing(
    two_computers: Problem, demands: dict[str, dict[str, float]], message: str
) -> None:
    planner = Planner(two_computers)
    before = planner.decide().objective
    with pytest.raises(UsageError, match=message):
        planner.update(demands)
    assert planner.decide().objective == before


def test_a_component_is_placed_and_released(two_computers: Problem) -> None:
    planner = Planner(two_computers)
    free = planner.decide().objective
    other = {"large": "small", "small": "large"}[planner.decide().placement["a"]]
    planner.place("a", other)
    held = planner.decide()
    assert held.placement["a"] == other
    assert held.objective is not None
    assert free is not None
    assert held.objective.total >= free.total
    planner.release("a")
    assert planner.decide().objective == free


def test_refuses_a_place_that_is_none(two_computers: Problem) -> None:
    planner = Planner(two_computers)
    with pytest.raises(UsageError, match="there is no component 'x'"):
        planner.place("x", "large")
    with pytest.raises(UsageError, match="it may run on large, small"):
        planner.place("a", "medium")
    with pytest.raises(UsageError, match="'a' is not held"):
        planner.release("a")


def test_without_time_it_is_the_greedy() -> None:
    problem = random_robot(3, 60, 5)
    result = plan.solve(problem, budget=0.0)
    assert result.method == "greedy"
    assert result.placement == plan.solve(problem, method="greedy").placement
