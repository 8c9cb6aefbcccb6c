"""Where CPU is short it is shared, by priority; memory never is."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError, UsageError
from poise.model.robot import Computer, Objective
from poise.plan import Bundle, Edge, Item, Planner, Problem, SoftLimit


def problem_of(
    demands: dict[str, float], capacity: float = 0.5, reserve: float = 0.0
) -> Problem:
    """Return components on two computers."""
    return Problem(
        components=tuple(Item(name=n, demand={"cpu": x}) for n, x in demands.items()),
        computers=tuple(
            Computer(name=name, capacity={"cpu": capacity}, reserve={"cpu": reserve})
            for name in ("x", "y")
        ),
    )


def test_what_does_not_fit_has_the_placement_of_least_shortage() -> None:
    asked = problem_of({"a": 0.27, "b": 0.27, "c": 0.40})
    assert not plan.solve(asked, why=False).feasible
    found = plan.solve(asked, overload="share")
    assert found.feasible
    assert found.proven
    assert found.placement["a"] == found.placement["b"] != found.placement["c"]
    (short,) = found.shortages
    assert short.amount == pytest.approx(0.04)


def test_what_fits_is_placed_as_without_sharing() -> None:
    asked = problem_of({"a": 0.2, "b": 0.2, "c": 0.3})
    found = plan.solve(asked, overload="share")
    assert found.placement == plan.solve(asked).placement
    assert found.shortages == ()


@pytest.mark.parametrize(
    "objective",
    [
        Objective(communication=10_000.0),
        Objective(scale="paper", weights={"memory": 1.0}),
    ],
)
def test_what_fits_is_not_short_whatever_the_weights(objective: Objective) -> None:
    """Sharing one computer costs 0.3 cores, and saves what F counts for much more."""
    asked = Problem(
        components=(
            Item(name="a", demand={"cpu": 0.8, "memory": 1e9}),
            Item(name="b", demand={"cpu": 0.5, "memory": 1e9}),
        ),
        computers=(
            Computer(name="x", capacity={"cpu": 1.0, "memory": 3e9}),
            Computer(name="y", capacity={"cpu": 0.6, "memory": 1e9}),
        ),
        connectors=(Edge(between=("a", "b")),),
        objective=objective,
    )
    found = plan.solve(asked, overload="share")
    assert found.shortages == ()
    assert found.placement == plan.solve(asked).placement


def test_a_higher_priority_is_short_last() -> None:
    """Three of 0.4 on two computers of 0.5: two share one, but not the high ones."""
    names = ("low", "high1", "high2")
    asked = replace(
        problem_of(dict.fromkeys(names, 0.4)),
        architectures=tuple(
            Bundle(name=n, components=(n,), priority=int(n != "low")) for n in names
        ),
    )
    where = plan.solve(asked, overload="share").placement
    assert where["high1"] != where["high2"]


def test_a_reserve_is_used_before_anything_is_short() -> None:
    asked = problem_of({"a": 0.5, "b": 0.5}, reserve=0.1)
    found = plan.solve(asked, overload="share")
    assert {*found.placement.values()} == {"x", "y"}
    assert [s.amount for s in found.shortages] == pytest.approx([0.05, 0.05])
    assert found.objective is not None
    assert found.objective.shortage < plan.PRICE * 0.01


def test_memory_is_not_shared() -> None:
    asked = problem_of({"a": 0.4, "b": 0.4})
    large = replace(
        asked,
        components=tuple(
            replace(c, demand={**c.demand, "memory": 2.0}) for c in asked.components
        ),
        computers=tuple(
            replace(h, capacity={**h.capacity, "memory": 1.0}) for h in asked.computers
        ),
    )
    found = plan.solve(large, overload="share")
    assert not found.feasible
    assert "memory" in found.reason
    assert "cpu" not in found.reason


def test_new_demands_count_for_soft_limits_too() -> None:
    limit = SoftLimit(resource="cpu", price=10.0, components=("a",))
    planner = Planner(replace(problem_of({"a": 0.1, "b": 0.1}), soft_limits=(limit,)))
    planner.update({"a": {"cpu": 0.7}})
    found = planner.decide()
    assert found.objective is not None
    assert found.objective.shortage == pytest.approx(10.0 * 0.2)
    planner.update({"a": {"cpu": 0.1}})
    assert planner.decide(overload="share").shortages == ()


def test_an_overload_that_is_not_known_is_refused() -> None:
    with pytest.raises(UsageError, match="overload is 'ignore', must be refuse or sh"):
        Planner(problem_of({"a": 0.1})).decide(overload="ignore")  # type: ignore[arg-type]


def test_a_wrong_soft_limit_is_refused() -> None:
    wrong = SoftLimit(resource="cpu", price=0.0, limits={"z": 1.0}, components=("q",))
    with pytest.raises(RobotError) as said:
        replace(problem_of({"a": 0.1}), soft_limits=(wrong,))
    for part in ("price is 0, must be above 0", "'z'", "'q'"):
        assert part in str(said.value)


def test_nothing_is_suspended_for_cpu_that_may_be_short() -> None:
    """Memory holds the first two; together they need 1.6 of one core, which is soft."""
    needs = {"high": (0.8, 6.0), "middle": (0.8, 4.0), "low": (0.1, 6.0)}
    problem = Problem(
        components=tuple(
            Item(name=name, demand={"cpu": cpu, "memory": memory})
            for name, (cpu, memory) in needs.items()
        ),
        computers=(Computer(name="one", capacity={"cpu": 1.0, "memory": 10.0}),),
        architectures=tuple(
            Bundle(name=name, components=(name,), priority=3 - i)
            for i, name in enumerate(needs)
        ),
        soft_limits=(SoftLimit(resource="cpu", price=10.0),),
    )
    assert plan.solve(problem, fewer=True).suspended == ("low",)
