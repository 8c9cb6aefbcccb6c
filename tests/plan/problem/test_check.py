"""Wrong problems are reported whole, by name, before anything is solved."""

from collections.abc import Callable
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from poise import plan
from poise.errors import PoiseError, RobotError, UsageError
from poise.model.robot import Computer, Link, Objective
from poise.plan import Bundle, Edge, Item, Problem
from tests.plan.plan_problems import problems


def test_reports_all_problems_at_once() -> None:
    with pytest.raises(RobotError) as caught:
        Problem(
            components=(
                Item(name="camera", demand={"cpu": nan}, only=("mian",)),
                Item(name="camera"),
            ),
            computers=(Computer(name="main", capacity={"cpu": -1}, speed=0),),
            connectors=(Edge(between=("camera", "tracker"), overhead=inf),),
            objective=Objective(communication=nan),
        )
    for expected in (
        "component 'camera' is there 2 times",
        "demand of cpu is nan",
        "did you mean 'main'",
        "capacity of cpu is -1",
        "speed is 0",
        "there is no component 'tracker'",
        "overhead is inf",
        "communication is nan",
    ):
        assert expected in str(caught.value)


def robot(number: float = 1.0, **more: Any) -> Problem:
    """Return a component on two computers that asks for `number`."""
    return Problem(
        components=(Item(name="a", demand={"cpu": number}), Item(name="b")),
        computers=(Computer(name="one", capacity={"cpu": 1.0}), Computer(name="two")),
        **more,
    )


text: Any = "1"
HUGE = pytest.param(-(10**5000), id="huge")
WRONG = [nan, inf, -inf, -1.0, 1e31, 1e300, 5e-324, 10**400, HUGE]


@pytest.mark.parametrize("number", WRONG)
def test_refuses_numbers_out_of_range(number: float) -> None:
    with pytest.raises(RobotError, match="demand of cpu is"):
        plan.solve(robot(number))


@pytest.mark.parametrize("number", WRONG)
@pytest.mark.parametrize(
    ("where", "problem"),
    [
        ("capacity of cpu", lambda x: _computer(capacity={"cpu": x})),
        ("speed", lambda x: _computer(speed=x)),
        ("price", lambda x: _computer(price=x)),
        ("move_cost", lambda x: _component(move_cost=x)),
        ("overhead", lambda x: _joined(overhead=x)),
        ("traffic", lambda x: _joined(traffic=x)),
        ("communication", lambda x: robot(objective=Objective(communication=x))),
        ("balance", lambda x: robot(objective=Objective(balance=x))),
        ("weight of cpu", lambda x: robot(objective=Objective(weights={"cpu": x}))),
        ("size of cpu", lambda x: robot(objective=Objective(sizes={"cpu": x}))),
        ("quality", lambda x: robot(objective=Objective(quality=x))),
        ("distance", lambda x: _linked(distance=x)),
    ],
)
def test_names_the_number_that_is_wrong(
    where: str, problem: Callable[[float], Problem], number: float
) -> None:
    with pytest.raises(RobotError, match=where):
        plan.solve(problem(number))


def _computer(**fields: Any) -> Problem:
    one, two = robot().computers
    return replace(robot(), computers=(replace(one, **fields), two))


def _component(**fields: Any) -> Problem:
    a, b = robot().components
    return replace(robot(), components=(replace(a, **fields), b))


def _linked(**fields: Any) -> Problem:
    return robot(links=(Link(**{"between": ("one", "two"), **fields}),))


def _joined(**fields: Any) -> Problem:
    return robot(connectors=(Edge(**{"between": ("a", "b"), **fields}),))


@pytest.mark.parametrize("share", [-0.1, 1.0, nan, inf])
def test_refuses_a_reserve_that_is_no_share(share: float) -> None:
    with pytest.raises(RobotError, match=r"reserve of cpu is .* must be in \[0, 1\)"):
        plan.solve(_computer(reserve={"cpu": share}))


@pytest.mark.parametrize("cost", [nan, inf, -inf, 1e31, -1e31, 1e-40])
def test_refuses_a_cost_out_of_range(cost: float) -> None:
    with pytest.raises(RobotError, match="component 'a': the size of its cost on two"):
        _component(cost={"one": -1.0, "two": cost})


@pytest.mark.parametrize("bandwidth", [nan, -1.0, -inf, 1e31])
def test_refuses_a_bandwidth_out_of_range(bandwidth: float) -> None:
    with pytest.raises(RobotError, match="link one - two: bandwidth"):
        _linked(bandwidth=bandwidth)


@pytest.mark.parametrize(
    ("problem", "message"),
    [
        (lambda: robot("1"), r"Expected `float`, got `str` - at `components"),  # type: ignore[arg-type]
        (lambda: robot(None), "got `null`"),  # type: ignore[arg-type]
        (lambda: replace(robot(), components=("a",)), r"got `str` - at `components"),
        (lambda: _computer(name=7), "computer 7: a name must be text"),
        (lambda: robot(together=(("a", "a"),)), "together: 'a' is there 2 times"),
        (lambda: robot(apart=(("b", "a", "b"),)), "apart: 'b' is there 2 times"),
        (lambda: robot(apart=(("a", "c"),)), "apart: there is no component 'c'"),
        (
            lambda: _component(only="one"),
            "component 'a': only is the text 'one', must be names",
        ),
        (lambda: _joined(between="ab"), "connector: between is the text 'ab'"),
        (lambda: robot(together=("ab",)), "together: a set is the text 'ab'"),
        (lambda: robot(exclusive={"arm": ("a", "c")}), "exclusive: there is no compon"),
        (lambda: robot(exclusive={"arm": "ab"}), "exclusive: a set is the text 'ab'"),
        (lambda: robot(apart="ab"), r"apart is the text 'ab', .* such as \['ab'\]$"),
        (lambda: _component(present="tow"), "did you mean 'two'"),
        (lambda: _joined(between=("a",)), "connector between a: it must join two"),
        (lambda: robot(objective=Objective(scale="papr")), "scale is 'papr', must be"),  # type: ignore[arg-type]
        (lambda: robot(objective=Objective(spread="std")), "spread is 'std', must be"),  # type: ignore[arg-type]
        (lambda: _component(cost={"tow": 1.0}), "did you mean 'two'"),
        (
            lambda: _linked(between=("one", "one")),
            "link between one, one: it must join two",
        ),
        (
            lambda: robot(architectures=(Bundle(name="A", components=("x",)),)),
            "architecture 'A': there is no component 'x'",
        ),
        (
            lambda: robot(
                architectures=(Bundle(name="A", components=(), priority=text),)
            ),
            "priority is '1', must be a whole number",
        ),
    ],
)
def test_refuses_what_makes_no_sense(
    problem: Callable[[], Problem], message: str
) -> None:
    with pytest.raises(RobotError, match=message):
        problem()


EXTREMES = st.sampled_from([0.0, 1e-30, 1e-15, 1.0, 1e15, 1e30, 10**29])


@pytest.mark.slow
@given(problems(most_components=5, most_computers=3), st.data())
def test_every_number_in_range_is_solved(problem: Problem, data: st.DataObject) -> None:
    """Whatever their sizes: an answer in finite numbers that keeps all limits."""

    def some(**fields: str) -> dict[str, Any]:
        return {
            field: {"cpu": data.draw(EXTREMES)} if kind else data.draw(EXTREMES)
            for field, kind in fields.items()
            if data.draw(st.booleans())
        }

    problem = replace(
        problem,
        components=tuple(
            replace(c, **some(demand="map", move_cost="")) for c in problem.components
        ),
        computers=tuple(replace(h, **some(capacity="map")) for h in problem.computers),
        connectors=tuple(
            replace(k, **some(overhead="", traffic="")) for k in problem.connectors
        ),
        objective=replace(
            problem.objective, **some(communication="", balance="", weights="map")
        ),
    )
    parts = problem.components
    for method in ("auto", "greedy", "search"):
        result = plan.solve(problem, steps=500, method=method)
        assert result.feasible == (len(result.placement) == len(problem.components))
        if result.objective is not None:
            assert isfinite(result.objective.total)
            assert result.bound is not None or not any(c.demand for c in parts)
            assert (result.bound or 0.0) <= result.objective.total


def test_components_may_ask_for_nothing() -> None:
    problem = Problem(
        components=(Item(name="a"), Item(name="b")),
        computers=(Computer(name="one"), Computer(name="two")),
    )
    for method in ("auto", "greedy", "exact", "search"):
        assert plan.solve(problem, method=method).feasible


def test_places_nothing_when_there_is_nothing_to_place() -> None:
    result = plan.solve(Problem(computers=(Computer(name="one"),)))
    assert result.feasible
    assert result.placement == {}


def test_refuses_components_without_computers() -> None:
    with pytest.raises(RobotError, match="no computers"):
        plan.solve(Problem(components=(Item(name="a"),)))


def test_an_empty_problem_is_solved() -> None:
    assert plan.solve(Problem()).feasible


@pytest.mark.parametrize("budget", [-1.0, nan, inf, "1", None, -(10**400)])
def test_refuses_a_budget_that_is_none(budget: float) -> None:
    with pytest.raises(UsageError, match="budget"):
        plan.solve(Problem(), budget=budget)


@pytest.mark.parametrize("budget", [0, 1e-300, 1e300, 10**400])
def test_takes_any_other_budget(two_computers: Problem, budget: float) -> None:
    assert plan.solve(two_computers, budget=budget).feasible


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"components": [{}]}', '{"componets": []}', '{"links": 1e999}'],
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
