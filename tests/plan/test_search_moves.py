"""Every search move, weighed and applied in the core, against the Python reference."""

import itertools
from random import Random

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from benchmarks.random_robots import random_robot
from poise.plan import Problem, objective
from poise.plan._core import Core
from poise.plan.engine import Engine
from poise.plan.limits import violations
from poise.plan.tables import Placed, Tables, tabulate
from tests.plan.plan_problems import problems

Move = tuple[list[int], list[int], int, int]

MANY = settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


def any_placement(tables: Tables, random: Random) -> Placed:
    everywhere = range(tables.m)
    return [random.choice(tables.allowed.get(u, everywhere)) for u in range(tables.n)]


def any_moves(tables: Tables, placed: Placed, random: Random, count: int) -> list[Move]:
    """Return moves, swaps and exchanges of groups, each from where the last led."""
    now = [*placed]
    moves: list[Move] = []
    for _ in range(count):
        a, b = random.sample(range(tables.m), 2)
        out = _some(tables, now, a, b, random)
        back = _some(tables, now, b, a, random)
        if out or back:
            moves.append((out, back, a, b))
            for unit in out:
                now[unit] = b
            for unit in back:
                now[unit] = a
    return moves


def _some(
    tables: Tables, placed: Placed, here: int, there: int, random: Random
) -> list[int]:
    every = range(tables.m)
    may = [
        u
        for u, computer in enumerate(placed)
        if computer == here and there in tables.allowed.get(u, every)
    ]
    return random.sample(may, random.choice([0, min(1, len(may)), len(may) // 2]))


def after(placed: Placed, move: Move) -> Placed:
    out, back, a, b = move
    return [
        b if u in out else a if u in back else computer
        for u, computer in enumerate(placed)
    ]


@pytest.mark.slow
@MANY
@given(problems(), st.randoms(use_true_random=False))
def test_every_search_move_is_worth_what_recomputing_says(
    problem: Problem, random: Random
) -> None:
    tables = tabulate(problem)
    assume(tables.m > 1 and all(tables.allowed.values()))
    placed = any_placement(tables, random)
    moves = any_moves(tables, placed, random, 12)
    before = objective.terms(tables, placed).total
    for move, kept in zip(moves, core_of(tables).walk(placed, moves), strict=True):
        change, _, paid, balance, excess, feasible = kept
        placed = after(placed, move)
        expected = objective.terms(tables, placed)
        near = 1e-9 * max(1.0, abs(expected.total), abs(before))
        assert paid == pytest.approx(
            expected.communication + expected.move, rel=1e-9, abs=near
        )
        assert balance == pytest.approx(expected.balance, rel=1e-9, abs=near)
        assert change == pytest.approx(expected.total - before, rel=1e-9, abs=near)
        broken = violations(tables, placed, objective.loads(tables, placed))
        assert feasible == (not broken)
        assert (excess > 0) == bool(broken)
        before = expected.total


@pytest.mark.slow
@MANY
@given(problems(), st.randoms(use_true_random=False))
def test_excess_changes_by_what_each_search_move_was_weighed_at(
    problem: Problem, random: Random
) -> None:
    tables = tabulate(problem)
    assume(tables.m > 1 and all(tables.allowed.values()))
    placed = any_placement(tables, random)
    moves = any_moves(tables, placed, random, 12)
    kept = core_of(tables).walk(placed, moves)
    for (_, _, _, _, before, _), (_, change, _, _, excess, _) in itertools.pairwise(
        kept
    ):
        # A link that carries nothing is exceeded a billionfold.
        near = 1e-9 * max(1.0, excess, before)
        assert change == pytest.approx(excess - before, rel=1e-9, abs=near)


@pytest.mark.parametrize(
    "move", [([0], [], 0, 0), ([0], [], 1, 0), ([0, 0], [], 0, 1), ([9], [], 0, 1)]
)
def test_refuses_a_search_move_that_is_none(two_computers: Problem, move: Move) -> None:
    core = core_of(tabulate(two_computers))
    with pytest.raises(ValueError, match="move"):
        core.walk([0, 0, 0, 0], [move])


def core_of(tables: Tables) -> Core:
    return Engine(tables).core


def test_search_moves_over_many_computers_are_worth_the_same() -> None:
    """Too many for a table of what each component pays on each computer."""
    tables = tabulate(random_robot(3, 700, 100))
    engine = Engine(tables)
    placed = any_placement(tables, Random(1))
    moves = any_moves(tables, placed, Random(2), 60)
    for move, kept in zip(moves, engine.core.walk(placed, moves), strict=True):
        _, _, paid, balance, *_ = kept
        placed = after(placed, move)
        assert paid + balance == pytest.approx(engine.total(placed), rel=1e-9)


def test_search_over_many_computers_never_gets_worse() -> None:
    engine = Engine(tabulate(random_robot(3, 700, 100, load=0.6)))
    start = engine.greedy()
    found = engine.search(start, steps=60_000)
    assert engine.feasible(found.placed)
    assert engine.total(found.placed) < engine.total(start)
