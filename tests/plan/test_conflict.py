"""An infeasible problem names what cannot hold together, and what must give way."""

import itertools
import math

import pytest
from hypothesis import given
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import Computer, Link
from poise.plan import Edge, Item, Problem
from poise.plan.conflict import _at_least
from poise.plan.problem.arrays import arrays_of
from poise.plan.problem.items import Run, TimeLimit
from poise.plan.problem_limits import limits_of, relaxed
from poise.plan.problem_limits import usual as usual_of
from poise.plan.violations import violations
from tests.plan.plan_problems import least, problems, small_robot


def computers(*sizes: float) -> tuple[Computer, ...]:
    return tuple(
        Computer(name=f"h{i}", capacity={"cpu": size}) for i, size in enumerate(sizes)
    )


def components(*demands: float) -> tuple[Item, ...]:
    return tuple(
        Item(name=f"c{i}", demand={"cpu": need}) for i, need in enumerate(demands)
    )


def test_names_a_component_that_is_too_large() -> None:
    result = plan.solve(Problem(components=components(1, 5), computers=computers(2, 4)))
    assert result.conflict is not None
    assert result.conflict.components == ("c1",)
    assert result.conflict.relaxation == "1 more cpu on h1 (4 now)"
    assert result.conflict.more == (plan.More(on=("h1",), resource="cpu", amount=1.0),)
    assert result.proven


def test_names_the_pinned_components_that_overfill_a_computer() -> None:
    """c1 and c2 are held to h0 and need 3 of its 2 cores; c0 is not to blame."""
    free, first, second = components(1, 1.5, 1.5)
    held = tuple(replace(c, only=("h0",)) for c in (first, second))
    result = plan.solve(Problem(components=(free, *held), computers=computers(2, 4)))
    assert result.conflict is not None
    assert set(result.conflict.components) == {"c1", "c2"}
    assert "h0" in result.conflict.limits[0]


def test_names_no_more_components_than_people_read() -> None:
    """Each once, whatever the order of their sizes."""
    problem = Problem(components=components(*range(1, 31)), computers=computers(460))
    assert plan.solve(problem).reason.startswith(
        "c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13 and 16 more together need"
    )


def test_says_how_much_all_computers_are_short_of() -> None:
    result = plan.solve(
        Problem(components=components(2, 2, 2), computers=computers(2, 2.5))
    )
    assert "together need 6 cpu; h0, h1 together have 4.5" in result.reason
    assert "1.5 more cpu on h1" in result.reason


def test_finds_what_cannot_be_packed() -> None:
    """Three of 2 need 6 of 3 + 3 in all, but no computer takes two of them."""
    problem = Problem(components=components(2, 2, 2, 0), computers=computers(3, 3))
    result = plan.solve(problem)
    assert not result.feasible
    assert result.conflict is not None
    assert set(result.conflict.components) == {"c0", "c1", "c2"}
    assert result.conflict.relaxation.startswith("1 more cpu on h")


def can_hold(problem: Problem) -> bool:
    """Whether any of all placements keeps every limit."""
    arrays = arrays_of(problem)
    every = itertools.product(range(arrays.m), repeat=arrays.n)
    return any(not violations(arrays, [*x]) for x in every)


def relieved(problem: Problem, conflict: plan.Conflict, part: float = 1.0) -> Problem:
    """Return the problem after what the relaxation says, or a part of each rise."""
    for more in conflict.more:
        is_whole = more.resource in {"bandwidth", "time"}
        names = more.on if is_whole else (*more.on, more.resource)
        (limit,) = (k for k in limits_of(problem) if k.most and k.names == names)
        problem = relaxed(problem, {limit: part * more.amount})
    for limit in limits_of(problem):
        if limit.advice and limit.advice in conflict.relaxation:
            problem = relaxed(problem, {limit: math.inf})
    return problem


@pytest.mark.slow
@given(problems(most_components=5, most_computers=3))
def test_a_conflict_is_small_and_its_way_out_leads_out(problem: Problem) -> None:
    result = plan.solve(problem, steps=2000)
    assert result.feasible == can_hold(problem)
    if result.feasible:
        return
    conflict = result.conflict
    assert conflict is not None
    names = set(conflict.components)
    assert not can_hold(plan.keep_components(problem, names))
    for name in names:
        assert can_hold(plan.keep_components(problem, names - {name}))
    assert can_hold(relieved(problem, conflict))
    if len(conflict.more) == 1 and "letting" not in conflict.relaxation:
        assert not can_hold(relieved(problem, conflict, part=0.99))


def test_a_raise_leaves_room_for_what_shares_the_cpu_and_has_a_time_limit() -> None:
    """c1 needs all of 0.1 cores, and then c0 would never end; with 0.15 in 30 ms."""
    runs = (Run(component="c0", seconds=0.01),)
    problem = Problem(
        components=components(0, 0.1),
        computers=computers(0),
        time_limits=(TimeLimit(name="t", limit=0.03, runs=runs, shared=True),),
    )
    conflict = plan.solve(problem).conflict
    assert conflict is not None
    assert conflict.relaxation == "0.15 more cpu on h0 (0 now)"
    assert can_hold(relieved(problem, conflict))


def test_the_cheapest_of_several_rises_is_named() -> None:
    """Either computer would do with 1 more, which is less of 8 than of 2."""
    big, small = computers(8, 2)
    held = replace(components(3)[0], only=("h1",), name="held")
    problem = Problem(components=(*components(4, 4), held), computers=(big, small))
    result = plan.solve(problem)
    assert result.conflict is not None
    assert result.conflict.relaxation == "1 more cpu on h1 (2 now)"
    free = replace(problem, components=(*components(4, 4), replace(held, only=())))
    result = plan.solve(free)
    assert result.conflict is not None
    assert result.conflict.relaxation == "1 more cpu on h1 (2 now)"


def test_a_way_out_of_several_rises() -> None:
    """Each of the two is held to a computer that is too small for it."""
    first, second = components(3, 5)
    problem = Problem(
        components=(replace(first, only=("h0",)), replace(second, only=("h1",))),
        computers=computers(2, 2),
    )
    result = plan.solve(problem)
    assert result.conflict is not None
    assert result.conflict.relaxation == (
        "1 more cpu on h0 (2 now) and 3 more cpu on h1 (2 now)"
    )


def test_a_rise_counts_speed_and_reserve() -> None:
    """3 cpu of demand need 2 cores of speed 2 of which a quarter is kept free."""
    one = Computer(name="h0", capacity={"cpu": 1}, speed=2, reserve={"cpu": 0.25})
    result = plan.solve(Problem(components=components(3), computers=(one,)))
    assert result.conflict is not None
    assert result.conflict.more == (plan.More(on=("h0",), resource="cpu", amount=1.0),)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_fleet_that_is_short_is_told_soon() -> None:
    robot = random_robot(1, 2000, 20, load=1.05)
    result = plan.solve(robot, budget=0.01)
    assert not result.feasible
    assert result.proven
    assert "together have" in result.reason


def test_names_components_that_must_be_together_and_apart() -> None:
    problem = Problem(
        components=components(1, 1),
        computers=computers(4, 4),
        together=(("c0", "c1"),),
        apart=(("c0", "c1"),),
    )
    result = plan.solve(problem)
    assert result.conflict is not None
    assert "together: c0, c1; apart: c0, c1" in result.reason
    assert result.reason.startswith("c0, c1 cannot hold together: ")
    assert can_hold(relieved(problem, result.conflict))


def test_names_pins_that_contradict_a_set_that_must_be_together() -> None:
    first, second = components(1, 1)
    problem = Problem(
        components=(replace(first, only=("h0",)), replace(second, only=("h1",))),
        computers=computers(4, 4),
        together=(("c0", "c1"),),
    )
    result = plan.solve(problem)
    assert not result.feasible
    assert "together: c0, c1" in result.reason
    assert "c0 may only run on h0" in result.reason


def test_names_the_link_that_is_too_slow() -> None:
    first, second = components(2, 2)
    problem = Problem(
        components=(first, second),
        computers=computers(3, 3),
        connectors=(Edge(between=("c0", "c1"), traffic=8.0),),
        links=(Link(between=("h0", "h1"), bandwidth=5.0),),
    )
    result = plan.solve(problem)
    assert not result.feasible
    assert "link h0 - h1" in result.reason


def test_the_greedy_says_where_it_came_to_a_dead_end() -> None:
    problem = Problem(components=components(2, 2, 2), computers=computers(3, 3))
    result = plan.solve(problem, method="greedy")
    assert not result.feasible
    assert "finds no computer for c2" in result.reason


def test_the_least_demand_has_a_way_out() -> None:
    """A raise of half of it, as the computer is twice as fast, is below all amounts."""
    problem = Problem(
        components=(Item(name="c", demand={"cpu": 1e-30}), Item(name="d")),
        computers=(Computer(name="h", capacity={"cpu": 0.0}, speed=2.0),),
        apart=(("c", "d"),),
    )
    assert plan.solve(problem).conflict is not None


@pytest.mark.slow
def test_a_conflict_is_irreducible_and_its_relaxation_the_least() -> None:
    """Against brute force: of all capacities and links, none is enough with less."""
    found = 0
    for seed in range(40):
        problem = small_robot(seed)
        result = plan.solve(problem)
        if result.feasible:
            continue
        found += 1
        conflict = result.conflict
        assert conflict is not None
        assert conflict.irreducible
        names = {*conflict.components}
        assert not holds(plan.keep_components(problem, names))
        for name in names:
            assert holds(plan.keep_components(problem, names - {name}))
        enough = [
            (limit, limit.most)
            for limit in limits_of(problem)
            if limit.most > 0 and holds(relaxed(problem, {limit: limit.most}))
        ]
        if not enough:
            continue
        assert "letting" not in conflict.relaxation
        raised = {(*more.on, more.resource): more.amount for more in conflict.more}
        raises = {
            limit: raised[names]
            for limit in limits_of(problem)
            for names in (limit.names, (*limit.names, "bandwidth"))
            if names in raised
        }
        assert len(raises) == len(conflict.more)
        assert holds(relaxed(problem, raises))
        assert conflict.price is not None
        assert conflict.price == pytest.approx(
            sum(more / usual_of(problem, limit) for limit, more in raises.items())
        )
        for limit, _ in enough:
            # Amounts are rounded up to one digit where that is enough.
            less = conflict.price * usual_of(problem, limit) / 1.5
            assert not holds(relaxed(problem, {limit: less}))
    assert found > 5


@pytest.mark.slow
def test_no_limit_is_named_that_is_not_in_conflict() -> None:
    """Without the others it cannot hold, and without any one of these it can."""
    found = 0
    for seed in range(40):
        problem = small_robot(seed)
        conflict = plan.solve(problem).conflict
        if conflict is None:
            continue
        part = plan.keep_components(problem, {*conflict.components})
        limits = [*limits_of(part)]
        if not {*conflict.limits} <= {limit.text for limit in limits}:
            continue  # what is short is told as one sum
        found += 1
        for limit in limits:
            part = (
                part
                if limit.text in conflict.limits
                else relaxed(part, {limit: math.inf})
            )
        assert not holds(part)
        for limit in limits:
            if limit.text in conflict.limits:
                assert holds(relaxed(part, {limit: math.inf}))
    assert found > 5


def holds(problem: Problem) -> bool:
    return least(problem) < math.inf


def test_says_memory_in_its_unit_and_how_much_is_short() -> None:
    """One GPU of 1 and one of 0.5: a demand of 1.25 is 0.25 short of the larger."""
    problem = Problem(
        components=(Item(name="net", demand={"gpu": 1.25, "memory": 2.0**32}),),
        computers=(
            Computer(name="h0", capacity={"gpu": 1.0, "memory": 2.0**30}),
            Computer(name="h1", capacity={"gpu": 0.5, "memory": 2.0**33}),
        ),
    )
    conflict = plan.solve(problem).conflict
    assert conflict is not None
    assert conflict.more
    assert "e+" not in str(plan.solve(problem).reason)
    tight = replace(problem, components=(Item(name="net", demand={"memory": 2.0**34}),))
    assert "needs 16 GiB memory; h0, h1 together have 9 GiB" in plan.solve(tight).reason
    assert _at_least(problem).startswith("at least 0.25 more gpu on ")
