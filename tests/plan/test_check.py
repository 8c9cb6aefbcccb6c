"""Wrong problems are reported whole, by name, before anything is solved."""

from math import inf, nan
from pathlib import Path

import pytest

from poise import plan
from poise.errors import PoiseError, RobotError, UsageError
from poise.model.robot import Objective
from poise.plan import Component, Computer, Connector, Problem


def test_reports_all_problems_at_once() -> None:
    problem = Problem(
        components=(
            Component(name="camera", demand={"cpu": nan}, only=("mian",)),
            Component(name="camera"),
        ),
        computers=(Computer(name="main", capacity={"cpu": -1}, speed=0),),
        connectors=(Connector(between=("camera", "tracker"), overhead=inf),),
        objective=Objective(communication=nan),
    )
    with pytest.raises(RobotError) as caught:
        plan.solve(problem)
    for expected in (
        "component 'camera' is there 2 times",
        "demand of cpu is nan",
        "did you mean 'main'",
        "capacity of cpu is -1",
        "speed is 0",
        "no component is called 'tracker'",
        "overhead is inf",
        "communication is nan",
    ):
        assert expected in str(caught.value)


@pytest.mark.parametrize("number", [nan, inf, -inf, -1.0, 1e300])
def test_refuses_numbers_out_of_range(number: float) -> None:
    problem = Problem(
        components=(Component(name="a", demand={"cpu": number}),),
        computers=(Computer(name="one", capacity={"cpu": 1.0}),),
    )
    with pytest.raises(RobotError, match="demand of cpu"):
        plan.solve(problem)


def test_places_nothing_when_there_is_nothing_to_place() -> None:
    result = plan.solve(Problem(computers=(Computer(name="one"),)))
    assert result.feasible
    assert result.placement == {}


def test_refuses_components_without_computers() -> None:
    with pytest.raises(RobotError, match="no computers"):
        plan.solve(Problem(components=(Component(name="a"),)))


def test_an_empty_problem_is_solved() -> None:
    assert plan.solve(Problem()).feasible


@pytest.mark.parametrize("budget", [-1.0, nan])
def test_refuses_a_budget_that_is_none(budget: float) -> None:
    with pytest.raises(UsageError, match="budget"):
        plan.solve(Problem(), budget=budget)


def test_takes_a_budget_of_zero(two_computers: Problem) -> None:
    assert plan.solve(two_computers, budget=0).feasible


def test_refuses_a_matrix_of_the_wrong_shape() -> None:
    problem = Problem(
        components=(Component(name="a"),),
        computers=(Computer(name="one"), Computer(name="two")),
        distance=((0.0, 1.0),),
        cost=((0.0,),),
    )
    with pytest.raises(RobotError, match="distance is 1 x") as caught:
        plan.solve(problem)
    assert "cost is 1 x" in str(caught.value)


def test_refuses_a_lopsided_distance() -> None:
    problem = Problem(
        components=(Component(name="a"),),
        computers=(Computer(name="one"), Computer(name="two")),
        distance=((0.0, 1.0), (2.0, 0.0)),
    )
    with pytest.raises(RobotError, match="one way"):
        plan.solve(problem)


def test_refuses_a_distance_of_a_computer_to_itself() -> None:
    problem = Problem(
        components=(Component(name="a"),),
        computers=(Computer(name="one"), Computer(name="two")),
        distance=((0.0, 1.0), (1.0, 0.5)),
    )
    with pytest.raises(RobotError, match="'two' to itself is 0"):
        plan.solve(problem)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"components": [{}]}', '{"componets": []}', '{"cost": 1e999}'],
)
def test_refuses_a_broken_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "problem.json"
    path.write_text(text)
    with pytest.raises(PoiseError, match=r"problem\.json"):
        plan.load(path)


def test_reads_a_file(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_text(
        '{"components": [{"name": "a", "demand": {"cpu": 1}}],'
        ' "computers": [{"name": "one", "capacity": {"cpu": 2}}]}'
    )
    assert plan.solve(plan.load(path)).placement == {"a": "one"}
