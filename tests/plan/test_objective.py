"""The objective, term by term, against numbers worked out by hand."""

import pytest
from msgspec.structs import replace

from poise import plan
from poise.model.robot import Computer, Link, Objective
from poise.plan import Edge, Item, Problem


def test_normalised_terms_are_shares(two_computers: Problem) -> None:
    """a, b on large; c, d on small: nothing crosses; residue 1/2 and 0 of capacity."""
    placement = {"a": "large", "b": "large", "c": "small", "d": "small"}
    objective = plan.evaluate(two_computers, placement).objective
    assert objective is not None
    assert objective.communication == 0
    assert objective.balance == pytest.approx(0.5 * 0.5)


def test_communication_is_a_share_of_all_overhead(two_computers: Problem) -> None:
    """Cutting a-b cuts 3 of 4: 0.5 * 3/4."""
    placement = {"a": "large", "b": "small", "c": "large", "d": "large"}
    objective = plan.evaluate(two_computers, placement).objective
    assert objective is not None
    assert objective.communication == pytest.approx(0.5 * 3 / 4)


def test_variance_is_the_population_variance(two_computers: Problem) -> None:
    """Residues 1/2 and 0: mean 1/4, variance 1/16."""
    problem = replace(two_computers, objective=Objective(spread="variance"))
    placement = {"a": "large", "b": "large", "c": "small", "d": "small"}
    objective = plan.evaluate(problem, placement).objective
    assert objective is not None
    assert objective.balance == pytest.approx(0.5 / 16)


def test_distance_scales_overhead(two_computers: Problem) -> None:
    link = Link(between=("large", "small"), distance=4.0)
    far = replace(two_computers, links=(link,))
    placement = {"a": "large", "b": "small", "c": "large", "d": "large"}
    objective = plan.evaluate(far, placement).objective
    assert objective is not None
    assert objective.communication == pytest.approx(4 * 0.5 * 3 / 4)


def test_linear_costs_and_moves_add_up() -> None:
    """2 on `right`, and 5 for leaving `left`."""
    item = Item(
        name="a", present="left", move_cost=5.0, cost={"left": 1.0, "right": 2.0}
    )
    problem = Problem(
        components=(item,), computers=(Computer(name="left"), Computer(name="right"))
    )
    moved = plan.evaluate(problem, {"a": "right"}).objective
    stayed = plan.evaluate(problem, {"a": "left"}).objective
    assert moved is not None
    assert stayed is not None
    assert (stayed.move, moved.move) == (1.0, 7.0)


def test_every_pair_counts_once(two_computers: Problem) -> None:
    """Two connectors between a and b add up to the overhead of one twice as heavy."""
    split = replace(
        two_computers,
        connectors=(
            Edge(between=("a", "b"), overhead=1.0),
            Edge(between=("b", "a"), overhead=2.0),
            Edge(between=("c", "d"), overhead=1.0),
        ),
    )
    placement = {"a": "large", "b": "small", "c": "large", "d": "large"}
    assert (
        plan.evaluate(split, placement).objective
        == plan.evaluate(two_computers, placement).objective
    )


def test_names_every_limit_that_a_given_placement_breaks(
    two_computers: Problem,
) -> None:
    placement = dict.fromkeys("abcd", "small")
    result = plan.evaluate(two_computers, placement)
    assert not result.feasible
    assert result.reason == "small: cpu needs 4, has 2: 2 short"


def test_a_split_set_is_a_broken_limit_and_f_stays_comparable(
    two_computers: Problem,
) -> None:
    """Of 3 and 1 only c-d can be cut where a and b stay together: a-b costs 3 times."""
    problem = replace(two_computers, together=(("a", "b"),))
    kept = plan.evaluate(
        problem, {"a": "large", "b": "large", "c": "large", "d": "small"}
    )
    split = plan.evaluate(
        problem, {"a": "large", "b": "small", "c": "large", "d": "large"}
    )
    assert (kept.feasible, split.feasible) == (True, False)
    assert split.reason == "a, b must share a computer: a is on large, b is on small"
    assert kept.objective is not None
    assert split.objective is not None
    assert kept.objective.communication == pytest.approx(0.5 * 1 / 1)
    assert split.objective.communication == pytest.approx(0.5 * 3 / 1)
    # large has 1 of 4 left, small 1 of 2
    assert split.objective.balance == pytest.approx(0.5 * 0.25)


def test_of_overlapping_sets_only_the_split_one_is_broken(
    two_computers: Problem,
) -> None:
    problem = replace(two_computers, together=(("a", "b"), ("b", "c")))
    placement = {"a": "large", "b": "large", "c": "small", "d": "large"}
    result = plan.evaluate(problem, placement)
    assert result.broken == ["b, c must share a computer: b is on large, c is on small"]
    assert result.placement == placement
    joined = plan.explain(problem, placement, "a")
    assert isinstance(joined, plan.Explanation)
    assert joined.together == ("b",)
