"""The C++ core against the Python reference, on random problems of every kind."""

import itertools
import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise.model.robot import Link, Spread
from poise.plan import Edge, Problem
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.violations import violations
from tests.plan.native import Native
from tests.plan.plan_problems import problems
from tests.plan.reference import objective
from tests.plan.reference.greedy import greedy, order

WIDE = [(200, 12, 6), (280, 260, 1)]


def solvable(arrays: Arrays) -> bool:
    """Whether every unit has a computer that it may run on."""
    return all(arrays.allowed.values())


def total(arrays: Arrays, placed: Placed) -> float:
    return objective.terms(arrays, placed).total


def keeps_limits(arrays: Arrays, placed: Placed) -> bool:
    return not violations(arrays, placed)


def optimum(arrays: Arrays) -> float:
    """Return the least F over all placements that keep every limit, by trying all."""
    every = itertools.product(range(arrays.m), repeat=arrays.n)
    feasible = (list(x) for x in every if keeps_limits(arrays, list(x)))
    return min((total(arrays, x) for x in feasible), default=math.inf)


@pytest.mark.slow
@given(problems())
def test_the_greedy_decides_like_the_reference(problem: Problem) -> None:
    arrays = arrays_of(problem)
    assert Native(arrays).greedy() == greedy(arrays)


@pytest.mark.parametrize("spread", ["range", "variance"])
def test_the_greedy_decides_like_the_reference_on_robots(spread: Spread) -> None:
    for seed in range(40):
        robot = random_robot(seed, 24, 2 + seed % 4, spread=spread, uneven=seed % 2 > 0)
        arrays = arrays_of(robot)
        assert Native(arrays).greedy() == greedy(arrays)


@pytest.mark.slow
@pytest.mark.parametrize("spread", ["range", "variance"])
@pytest.mark.parametrize(("components", "computers", "seed"), WIDE)
def test_the_greedy_goes_where_recomputing_finds_the_least(
    components: int, computers: int, seed: int, spread: Spread
) -> None:
    """Over many computers it leaves most of them out of account."""
    robot = random_robot(seed, components, computers, spread=spread)
    names = [c.name for c in robot.components]
    apart = tuple(zip(names[::7], names[1::7], strict=False))
    arrays = arrays_of(replace(robot, apart=apart))
    engine = Native(arrays)
    decided = engine.greedy()
    placed, left = [-1] * arrays.n, [*arrays.limit]
    for unit in order(arrays):
        totals = _totals(engine, placed, left, unit)
        least = min(totals)
        if decided[unit] < 0:
            assert least == math.inf
            return
        near = least + 1e-12 * max(1.0, least)
        assert decided[unit] == next(h for h, t in enumerate(totals) if t <= near)
        placed[unit] = decided[unit]
        for k in range(arrays.r):
            left[decided[unit] * arrays.r + k] -= arrays.demand[unit * arrays.r + k]


def _totals(
    engine: Native, placed: Placed, left: list[float], unit: int
) -> list[float]:
    """Return F with `unit` on each computer, infinite where it may not be."""
    arrays = engine.arrays
    need = arrays.demand[unit * arrays.r : (unit + 1) * arrays.r]
    shut = {placed[i + j - unit] for i, j in arrays.apart if unit in (i, j)}
    totals = []
    for h in range(arrays.m):
        room = left[h * arrays.r : (h + 1) * arrays.r]
        placed[unit] = h
        fits = all(d <= x + 1e-9 for d, x in zip(need, room, strict=True))
        fits &= h in arrays.allowed.get(unit, (h,)) and h not in shut
        totals.append(engine.total(placed) if fits else math.inf)
    placed[unit] = -1
    return totals


@pytest.mark.slow
@given(problems(), st.randoms(use_true_random=False))
def test_terms_and_limits_are_those_of_the_reference(
    problem: Problem,
    random: Random,
) -> None:
    arrays = arrays_of(problem)
    placed = [random.randrange(arrays.m) for _ in range(arrays.n)]
    engine = Native(arrays)
    expected = total(arrays, placed)
    assert engine.total(placed) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert engine.feasible(placed) == keeps_limits(arrays, placed)


@pytest.mark.slow
@given(problems(most_components=5, most_computers=3))
def test_branch_and_bound_finds_the_optimum(problem: Problem) -> None:
    arrays = arrays_of(problem)
    answer = Native(arrays).exact([])
    best = optimum(arrays)
    assert answer.proven
    if best == math.inf:
        assert not answer.placed
        return
    assert keeps_limits(arrays, answer.placed)
    assert total(arrays, answer.placed) == pytest.approx(best, rel=1e-9, abs=1e-9)
    if arrays.n:
        assert answer.bound == pytest.approx(best, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("spread", ["range", "variance"])
@pytest.mark.parametrize("pinned", [0.0, 0.2])
def test_the_proof_on_two_computers_is_the_least_of_all(
    spread: Spread, pinned: float
) -> None:
    for seed in range(12):
        robot = random_robot(
            seed,
            9,
            2,
            spread=spread,
            degree=1 + seed % 5,
            pinned=pinned,
            uneven=seed % 2 > 0,
        )
        if seed % 3 == 0:
            costly = (
                replace(c, cost={"computer0": 0.02 * (i % 3)})
                for i, c in enumerate(robot.components)
            )
            robot = replace(robot, components=tuple(costly))
        arrays = arrays_of(robot)
        answer = Native(arrays).exact([])
        best = optimum(arrays)
        assert answer.proven
        if best == math.inf:
            assert not answer.placed
            continue
        assert keeps_limits(arrays, answer.placed)
        assert total(arrays, answer.placed) == pytest.approx(best, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("spread", ["range", "variance"])
@pytest.mark.parametrize("degree", [2, 3, 12])
def test_every_proof_on_two_computers_finds_the_same(
    spread: Spread, degree: int
) -> None:
    """A link that limits nothing takes the general tree; many ties that by pulls."""
    for seed in range(6):
        robot = random_robot(seed, 20, 2, spread=spread, degree=degree)
        if degree > 8:
            robot = replace(robot, connectors=_all_to_all(robot, seed))
        link = Link(between=("computer0", "computer1"), bandwidth=1e29)
        linked = replace(robot, links=(link,))
        answers = [Native(arrays_of(p)).exact([]) for p in (robot, linked)]
        assert all(answer.proven for answer in answers)
        assert [bool(answer.placed) for answer in answers] in ([True] * 2, [False] * 2)
        assert answers[0].bound == pytest.approx(answers[1].bound, rel=1e-9)


def _all_to_all(robot: Problem, seed: int) -> tuple[Edge, ...]:
    random = Random(seed)
    names = [c.name for c in robot.components]
    pairs = itertools.combinations(names, 2)
    return tuple(Edge(between=p, overhead=random.random()) for p in pairs)


@pytest.mark.slow
@given(problems(most_components=5, most_computers=3))
def test_the_bound_is_below_every_placement(problem: Problem) -> None:
    arrays = arrays_of(problem)
    if solvable(arrays):
        assert Native(arrays).bound() <= optimum(arrays) + 1e-9


@pytest.mark.slow
@given(problems(), st.integers(0, 5))
def test_search_keeps_limits_and_never_gets_worse(problem: Problem, seed: int) -> None:
    arrays = arrays_of(problem)
    engine = Native(arrays)
    start = engine.greedy()
    start = [] if -1 in start else start
    answer = engine.search(start, steps=3000, seed=seed)
    if answer.placed:
        assert keeps_limits(arrays, answer.placed)
    if start:
        assert total(arrays, answer.placed) <= total(arrays, start) + 1e-9


@pytest.mark.slow
@given(problems(most_components=6, most_computers=3))
def test_search_finds_the_optimum_of_small_problems(problem: Problem) -> None:
    arrays = arrays_of(problem)
    engine = Native(arrays)
    answer = engine.search([], steps=20_000)
    exact = engine.exact([])
    if answer.placed:
        assert total(arrays, answer.placed) <= total(arrays, exact.placed) * 1.02 + 1e-9


@pytest.mark.parametrize("spread", ["range", "variance"])
def test_a_seed_and_a_step_limit_give_one_placement(spread: Spread) -> None:
    engine = Native(arrays_of(random_robot(3, 40, 4, spread=spread)))
    runs = [engine.search([], steps=20_000, seed=7).placed for _ in range(2)]
    assert runs[0] == runs[1]


def test_links_that_carry_everything_change_nothing() -> None:
    robot = random_robot(1, 50, 4)
    # In the normalised scale they would change what communication counts for.
    robot = replace(robot, objective=replace(robot.objective, scale="paper"))
    names = [h.name for h in robot.computers]
    busy = tuple(replace(c, traffic=1.0) for c in robot.connectors)
    links = tuple(
        Link(between=pair, bandwidth=1e6) for pair in itertools.combinations(names, 2)
    )
    linked = replace(robot, connectors=busy, links=links)
    free = Native(arrays_of(robot)).search([], steps=50_000, seed=1)
    assert (
        Native(arrays_of(linked)).search([], steps=50_000, seed=1).placed == free.placed
    )


def test_an_unfinished_proof_still_gives_a_bound() -> None:
    arrays = arrays_of(random_robot(1, 24, 4))
    engine = Native(arrays)
    best = engine.exact(engine.search([], steps=50_000).placed)
    cut = engine.exact(engine.greedy(), steps=3000)
    assert best.proven
    assert not cut.proven
    assert cut.bound <= total(arrays, best.placed) + 1e-9
    assert cut.stopped_by == "budget"


def test_renaming_equal_computers_changes_nothing() -> None:
    robot = random_robot(5, 16, 3, pinned=0.0)
    turned = Problem(
        components=robot.components,
        computers=robot.computers[::-1],
        connectors=robot.connectors,
        objective=robot.objective,
    )
    first, second = (Native(arrays_of(p)) for p in (robot, turned))
    assert first.exact([]).bound == pytest.approx(second.exact([]).bound, abs=1e-12)


def test_dropping_a_pin_never_raises_the_optimum() -> None:
    robot = random_robot(6, 14, 3, pinned=0.4)
    free = random_robot(6, 14, 3, pinned=0.4)
    free = replace(free, components=tuple(replace(c, only=()) for c in free.components))
    pinned_best = Native(arrays_of(robot)).exact([]).bound
    assert Native(arrays_of(free)).exact([]).bound <= pinned_best + 1e-12
