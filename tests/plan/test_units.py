"""F of a problem, its parts and its alternatives is in one unit."""

from math import inf
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import RobotError
from poise.model.robot import Computer, Link, Objective
from poise.plan import Bundle, Edge, Item, Problem

COMPUTERS = tuple(Computer(name=name, capacity={"cpu": 1.0}) for name in ("h0", "h1"))


def item(name: str, cpu: float = 0.0, *only: str) -> Item:
    return Item(name=name, demand={"cpu": cpu}, only=only)


def chat(one: str, two: str, overhead: float = 1.0, traffic: float = 0.0) -> Edge:
    return Edge(between=(one, two), overhead=overhead, traffic=traffic)


FOUR = Problem(
    components=(
        item("a", 0.3),
        item("b", 0.3),
        item("c", 0.1, "h0"),
        item("d", 0.1, "h1"),
    ),
    computers=COMPUTERS,
    connectors=(chat("a", "b", 10.0), chat("a", "c"), chat("b", "d")),
)


def with_pair(problem: Problem, *pair: Item, overhead: float = 100.0) -> Problem:
    """Return the problem with two more components that talk with each other."""
    one, two = (each.name for each in pair)
    return replace(
        problem,
        components=(*problem.components, *pair),
        connectors=(*problem.connectors, chat(one, two, overhead)),
    )


def held_pair() -> Problem:
    return with_pair(FOUR, item("x", 0.0, "h0"), item("y", 0.0, "h0"))


def free_pair() -> Problem:
    whole = with_pair(FOUR, item("x"), item("y"))
    return replace(whole, together=(("x", "y"),))


def half_held_pair() -> Problem:
    """One end is held to h0, and the other must be with it, so it is held as well."""
    third = with_pair(FOUR, item("x", 0.0, "h0"), item("y"))
    whole = replace(third, components=(*third.components, item("z", 0.0, "h0")))
    return replace(whole, together=(("y", "z"),))


@pytest.mark.parametrize("more", [held_pair(), free_pair(), half_held_pair()])
def test_a_pair_that_is_never_apart_changes_nothing(more: Problem) -> None:
    """Cutting a - c costs 1 of 12, whatever x and y say to each other."""
    alone, beside = plan.solve(FOUR), plan.solve(more)
    assert alone.objective is not None
    assert alone.objective.communication == pytest.approx(0.5 / 12)
    assert beside.objective == alone.objective
    assert {name: beside.placement[name] for name in "abcd"} == alone.placement


def test_traffic_that_crosses_no_link_fills_none() -> None:
    """The pair inside h0 sends 100 B/s; of the link of 10 B/s, 3 B/s are 30 %."""
    link = Link(between=("h0", "h1"), bandwidth=10.0)
    sends = tuple(replace(k, traffic=1.0) for k in FOUR.connectors)
    narrow = replace(FOUR, links=(link,), connectors=sends)
    pair = item("x", 0.0, "h0"), item("y", 0.0, "h0")
    busy = replace(with_pair(narrow, *pair), connectors=(*sends, chat("x", "y", 9, 99)))
    split = {"a": "h0", "b": "h1", "c": "h0", "d": "h1", "x": "h0", "y": "h0"}
    objective = plan.evaluate(busy, split).objective
    assert objective is not None
    assert objective.communication == pytest.approx(0.5 * 0.3 * 10 / 12)


def camera_and_arm(*bundles: Bundle, objective: Objective | None = None) -> Problem:
    """Return function f by A, which sends 1 over the network, or by B, which sends 5.

    B has a heavy connector inside, on one computer.
    """
    return Problem(
        components=(
            item("cam", 0.1, "h0"),
            item("arm", 0.1, "h1"),
            item("A1", 0.2, "h1"),
            item("B1", 0.3, "h1"),
            item("B2", 0.2, "h1"),
        ),
        computers=COMPUTERS,
        connectors=(
            chat("cam", "A1"),
            chat("cam", "B1", 5.0),
            chat("B1", "B2", 200.0),
            chat("cam", "arm"),
        ),
        architectures=(*bundles, Bundle(name="rest", components=("cam", "arm"))),
        objective=objective or Objective(balance=0.0),
    )


A = Bundle(name="A", function="f", components=("A1",))
B = Bundle(name="B", function="f", components=("B1", "B2"))


@pytest.mark.parametrize("bundles", [(A, B), (B, A)])
def test_what_is_inside_an_alternative_does_not_make_it_cheaper(
    bundles: tuple[Bundle, ...],
) -> None:
    """Of the 2 that A and the rest send, A sends all; B would send three times that."""
    problem = camera_and_arm(*bundles)
    result = plan.solve(problem)
    assert result.architectures == {"f": "A"}
    assert result.objective is not None
    assert result.objective.total == pytest.approx(0.5 * 2 / 2)
    rejection = plan.explain(problem, result.placement, "B")
    assert isinstance(rejection, plan.Rejection)
    assert rejection.change is not None
    assert rejection.change.communication == pytest.approx(0.5 * (6 - 2) / 2)


def test_a_lesser_alternative_does_not_change_the_unit() -> None:
    """However much it would send, F with A is as if there were no B."""
    both = camera_and_arm(A, replace(B, quality=0.5))
    both = replace(both, components=tuple(replace(c, only=()) for c in both.components))
    only_a = replace(
        both,
        components=both.components[:3],
        connectors=(both.connectors[0], both.connectors[3]),
        architectures=(A, both.architectures[-1]),
    )
    here = {"cam": "h0", "arm": "h1", "A1": "h1"}
    for problem in (both, only_a):
        objective = plan.evaluate(problem, here).objective
        assert objective is not None
        assert objective.communication == pytest.approx(0.5)


def test_a_part_counts_overhead_as_the_whole_does() -> None:
    """Without b, cutting a - c still costs 1 of 12."""
    part = plan.keep_components(FOUR, {"a", "c", "d"})
    objective = plan.evaluate(part, {"a": "h1", "c": "h0", "d": "h1"}).objective
    assert objective is not None
    assert objective.communication == pytest.approx(0.5 / 12)


def test_what_if_a_component_ran_there_is_in_the_same_unit() -> None:
    """Held to one computer, a and b could never be apart; F of the same is the same."""
    planner = plan.Planner(FOUR)
    for name in ("a", "b"):
        planner.place(name, "h0")
    placement = planner.decide().placement
    assert planner.decide().objective == plan.evaluate(FOUR, placement).objective


def test_a_problem_written_as_json_is_the_same(tmp_path: Path) -> None:
    part = plan.keep_components(FOUR, {"a", "c"})
    assert part.overhead_scale == pytest.approx(1 / 12)
    unlimited = Link(between=("h0", "h1"), bandwidth=inf, latency=0.001)
    part = replace(part, links=(unlimited,))
    path = tmp_path / "part.json"
    path.write_bytes(msgspec.json.encode(part))
    assert plan.load(path) == part
    with pytest.raises(RobotError, match="overhead_scale is -1"):
        replace(FOUR, overhead_scale=-1.0)


def test_the_paper_s_scale_has_overhead_as_given() -> None:
    paper = replace(FOUR, objective=Objective(scale="paper"))
    part = plan.keep_components(paper, {"a", "b"})
    assert part.overhead_scale is None
    objective = plan.evaluate(part, {"a": "h0", "b": "h1"}).objective
    assert objective is not None
    assert objective.communication == 0.5 * 10


@given(seed=st.integers(0, 10**6), count=st.integers(1, 4), held=st.booleans())
def test_components_that_need_nothing_and_say_nothing_change_no_f(
    *, seed: int, count: int, held: bool
) -> None:
    """With them or without, every placement of the others has the same F."""
    problem = random_robot(seed, 6, 2)
    only = ("computer0",) if held else ()
    idle = tuple(Item(name=f"idle{i}", only=only) for i in range(count))
    whole = replace(problem, components=(*problem.components, *idle))
    part = plan.keep_components(whole, {c.name for c in problem.components})
    placement = plan.solve(whole, method="greedy").placement
    kept = {name: placement[name] for name in placement if "idle" not in name}
    if not kept:
        return
    f = plan.evaluate(whole, placement).objective
    assert f is not None
    assert plan.evaluate(part, kept).objective == f
    assert plan.evaluate(problem, kept).objective == f
    assert plan.solve(part).objective == plan.solve(problem).objective
