"""What if: computers gone, added, larger or smaller, and as few as possible."""

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import UsageError
from poise.model.robot import Computer, Link
from poise.plan import Problem


def test_without_a_computer_all_goes_to_the_others(two_computers: Problem) -> None:
    fewer = plan.without(two_computers, ["small"])
    assert set(plan.solve(fewer).placement.values()) == {"large"}


def test_without_refuses_to_strand_a_component(two_computers: Problem) -> None:
    held = replace(two_computers.components[0], only=("small",))
    problem = replace(two_computers, components=(held, *two_computers.components[1:]))
    with pytest.raises(UsageError, match="can run nowhere: a"):
        plan.without(problem, ["small"])


def test_without_names_the_computers_there_are(two_computers: Problem) -> None:
    with pytest.raises(UsageError, match="'large', 'small'"):
        plan.without(two_computers, ["tiny"])


def test_an_added_computer_may_be_used(two_computers: Problem) -> None:
    more = plan.add(two_computers, Computer(name="new", capacity={"cpu": 2.0}))
    assert "new" in plan.solve(more).placement.values()


def test_scale_takes_a_resource_or_a_computer(two_computers: Problem) -> None:
    half = plan.scale(two_computers, {"CPU": 0.5})
    assert [h.capacity["cpu"] for h in half.computers] == [2.0, 1.0]
    twice = plan.scale(two_computers, {"small": 2.0})
    assert [h.capacity["cpu"] for h in twice.computers] == [4.0, 4.0]
    with pytest.raises(UsageError, match="neither a computer nor a resource"):
        plan.scale(two_computers, {"gpu": 2.0})


def test_scale_takes_the_computer_that_is_spelt_so(two_computers: Problem) -> None:
    """Where two names differ only in case, the other one keeps what it has."""
    problem = plan.add(two_computers, Computer(name="Small", capacity={"cpu": 1.0}))
    twice = plan.scale(problem, {"Small": 2.0, "small": 3.0})
    assert [h.capacity["cpu"] for h in twice.computers] == [4.0, 6.0, 2.0]


def test_links_and_costs_go_with_their_computer(two_computers: Problem) -> None:
    costly = tuple(
        replace(c, cost={"large": 0.5, "small": 1.0}) for c in two_computers.components
    )
    link = Link(between=("large", "small"), distance=2.0)
    problem = replace(two_computers, links=(link,), components=costly)
    more = plan.add(problem, Computer(name="new", capacity={"cpu": 2.0}))
    assert plan.solve(more).feasible
    # a - b and c - d have 4 together
    assert plan.without(more, ["new"]) == replace(problem, overhead_scale=1 / 4)
    left = plan.without(more, ["small"])
    assert left.links == ()
    assert left.components[0].cost == {"large": 0.5}


def smallest(problem: Problem) -> plan.Smallest:
    whole = plan.TaskProblem.of_one("all", problem)
    return plan.smallest([whole], plan.solve_phases)


def test_smallest_finds_the_fewest_computers(two_computers: Problem) -> None:
    """Four of 1 fit the large computer of 4."""
    few = smallest(two_computers)
    assert few.computers == ("large",)
    assert few.feasible


def test_smallest_weighs_prices(two_computers: Problem) -> None:
    """Three small ones at 1 are cheaper than the large one at 10; two have room."""
    large, small = two_computers.computers
    problem = replace(
        two_computers,
        computers=(
            replace(large, price=10.0),
            *(replace(small, name=f"small{i}") for i in range(3)),
        ),
    )
    kept, _, _ = smallest(problem)
    assert kept == ("small0", "small1")


def test_smallest_drops_one_by_one_when_there_are_many(
    two_computers: Problem,
) -> None:
    many = tuple(Computer(name=f"h{i}", capacity={"cpu": 2.0}) for i in range(14))
    few = smallest(replace(two_computers, computers=many))
    assert len(few.computers) == 2
    assert few.feasible
