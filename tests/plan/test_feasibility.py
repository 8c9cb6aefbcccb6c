"""Robots so full that hardly any placement keeps the limits."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.model.robot import Computer, Link
from poise.plan import Edge, Item, Problem, solve
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.violations import violations
from tests.plan.native import Native
from tests.plan.plan_problems import problems


def keeps_limits(arrays: Arrays, placed: Placed) -> bool:
    return not violations(arrays, placed)


def full_robot(
    seed: int, components: int, computers: int, *, slack: float, apart: int = 0
) -> Problem:
    """Return a robot whose computers have `slack` more than one placement needs.

    A tenth of the components are pinned, and `apart` pairs must not share a computer,
    all as that placement has it.
    """
    random = Random(seed)
    home = [random.randrange(computers) for _ in range(components)]
    demand = [(random.lognormvariate(0, 0.7), random.random()) for _ in home]
    used = [
        [
            sum(d[k] for d, there in zip(demand, home, strict=True) if there == h)
            for k in (0, 1)
        ]
        for h in range(computers)
    ]
    strangers = [
        (i, j) for i in range(components) for j in range(i) if home[i] != home[j]
    ]
    return Problem(
        components=tuple(
            Item(
                name=f"c{i}",
                demand={"cpu": demand[i][0], "memory": demand[i][1]},
                only=(f"h{h}",) if random.random() < 0.1 else (),
            )
            for i, h in enumerate(home)
        ),
        computers=tuple(
            Computer(
                name=f"h{h}",
                capacity={"cpu": cpu * (1 + slack), "memory": memory * (1 + slack)},
            )
            for h, (cpu, memory) in enumerate(used)
        ),
        apart=tuple(
            (f"c{i}", f"c{j}")
            for i, j in random.sample(strangers, min(apart, len(strangers)))
        ),
    )


@pytest.mark.slow
@given(problems(most_components=6, most_computers=3), st.integers(0, 3))
def test_search_finds_a_placement_where_there_is_one(
    problem: Problem, seed: int
) -> None:
    arrays = arrays_of(problem)
    engine = Native(arrays)
    there_is = bool(engine.exact([]).placed)
    found = engine.search([], steps=20_000, seed=seed).placed
    assert bool(found) == there_is
    if found:
        assert keeps_limits(arrays, found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [(12, 2), (24, 4), (50, 6), (100, 8)])
def test_robots_with_a_hundredth_to_spare_are_placed(
    seed: int, size: tuple[int, int]
) -> None:
    arrays = arrays_of(full_robot(seed, *size, slack=0.01))
    found = Native(arrays).search([], steps=300_000, seed=1).placed
    assert found
    assert keeps_limits(arrays, found)


@pytest.mark.parametrize("seed", range(10))
def test_full_robots_keep_apart_what_must_be(seed: int) -> None:
    arrays = arrays_of(full_robot(seed, 24, 4, slack=0.03, apart=12))
    found = Native(arrays).search([], steps=300_000, seed=1).placed
    assert found
    assert keeps_limits(arrays, found)


def test_a_full_robot_is_placed_alike_for_a_seed_and_a_step_limit() -> None:
    engine = Native(arrays_of(full_robot(3, 50, 6, slack=0.01)))
    first, second = (engine.search([], steps=200_000, seed=7) for _ in range(2))
    assert first.placed
    assert first.placed == second.placed


@pytest.mark.parametrize("steps", [0, 1, 100, 100_000])
def test_the_step_limit_ends_the_search_for_what_does_not_exist(steps: int) -> None:
    problem = Problem(
        components=tuple(Item(name=f"c{i}", demand={"cpu": 1.0}) for i in range(9)),
        computers=tuple(
            Computer(name=f"h{h}", capacity={"cpu": 2.5}) for h in range(4)
        ),
    )
    answer = Native(arrays_of(problem)).search([], steps=steps)
    assert not answer.placed
    assert answer.stopped_by == "budget"
    assert answer.steps <= steps + 2000


def test_search_finds_what_a_link_without_bandwidth_leaves() -> None:
    """All that talks must go where the last one is pinned; nothing else counts."""
    names = [f"c{i}" for i in range(6)]
    problem = Problem(
        components=tuple(
            Item(name=name, demand={"cpu": 0.0}, only=("h1",) if name == "c4" else ())
            for name in names
        ),
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0}) for name in ("h0", "h1")
        ),
        connectors=(
            Edge(between=("c5", "c0"), overhead=0.0),
            Edge(between=("c1", "c0"), traffic=1.0),
            Edge(between=("c4", "c0"), traffic=3.0),
        ),
        links=(Link(between=("h0", "h1"), bandwidth=0.0),),
    )
    arrays = arrays_of(problem)
    for seed in range(4):
        placed = Native(arrays).search([], steps=20_000, seed=seed).placed
        assert placed
        assert keeps_limits(arrays, placed)


@pytest.mark.parametrize("method", ["auto", "exact", "search"])
def test_what_is_beyond_a_limit_by_rounding_is_an_answer_and_no_error(
    method: str,
) -> None:
    """The greedy finds room for 1 + 1e-9, which is the slack; others may find none."""
    demands = {"a": 1e-9, "b": 1.0}
    items = (Item(name=n, demand={"memory": m}) for n, m in demands.items())
    problem = Problem(
        components=tuple(items),
        computers=(Computer(name="h", capacity={"memory": 1.0}),),
        together=(("a", "b"),),
    )
    result = solve(problem, method=method)
    assert result.feasible or result.reason
