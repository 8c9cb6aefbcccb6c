"""Communication alone, with one limit for each computer: graphs to be cut."""

import itertools
from random import Random
from time import thread_time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.placement.graphs import KINDS, Pairs, cube, grid
from poise.model.robot import Objective
from poise.plan import Component, Computer, Connector, Problem
from poise.plan.engine import Answer, Engine
from poise.plan.tables import tabulate


def cut_problem(
    demands: list[float],
    overheads: dict[tuple[int, int], float],
    limits: list[float],
) -> Problem:
    names = [f"c{i}" for i in range(len(demands))]
    return Problem(
        components=tuple(
            Component(name=name, demand={"cpu": demand})
            for name, demand in zip(names, demands, strict=True)
        ),
        computers=tuple(
            Computer(name=f"h{i}", capacity={"cpu": limit})
            for i, limit in enumerate(limits)
        ),
        connectors=tuple(
            Connector(between=(names[i], names[j]), overhead=overhead)
            for (i, j), overhead in overheads.items()
        ),
        objective=Objective(communication=1.0, balance=0.0, scale="paper"),
    )


def even(n: int, pairs: Pairs, blocks: int) -> Engine:
    limits = [1.03 * -(-n // blocks)] * blocks
    return Engine(tabulate(cut_problem([1.0] * n, dict.fromkeys(pairs, 1.0), limits)))


def cut(engine: Engine, answer: Answer) -> float:
    assert engine.feasible(answer.placed)
    return engine.total(answer.placed)


def test_halves_a_square_along_its_middle() -> None:
    engine = even(*grid(400, Random(1)), 2)
    assert cut(engine, engine.search([], steps=100_000)) == pytest.approx(20)


def test_halves_a_cube_along_its_middle() -> None:
    engine = even(*cube(1000, Random(1)), 2)
    assert cut(engine, engine.search([], steps=300_000)) == pytest.approx(100)


def test_finds_clusters_again() -> None:
    random = Random(3)
    clusters, size = 8, 60
    mixed = random.sample(range(clusters * size), clusters * size)
    overheads: dict[tuple[int, int], float] = {}
    for c in range(clusters):
        mine = mixed[c * size : (c + 1) * size]
        overheads |= {
            (i, j): 1.0 for i in mine for j in random.sample(mine, 6) if i < j
        }
        overheads |= {(min(p), max(p)): 1.0 for p in itertools.pairwise(mine)}
        # A ring of clusters: eight connectors lead from one to the next.
        overheads[mine[0], mixed[(c + 1) * size % len(mixed) + 1]] = 1.0
    problem = cut_problem([1.0] * len(mixed), overheads, [62.0] * clusters)
    engine = Engine(tabulate(problem))
    assert cut(engine, engine.search([], steps=200_000)) <= clusters


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(["grid", "cube", "geometric", "scale-free", "robots"]),
    blocks=st.integers(2, 12),
    steps=st.sampled_from([0, 1, 1_000, 10_000, 50_000]),
    seed=st.integers(0, 1000),
)
def test_keeps_limits_never_gets_worse_and_repeats_itself(
    kind: str, blocks: int, steps: int, seed: int
) -> None:
    random = Random(seed)
    n, pairs = KINDS[kind](450, random)
    demands = [random.choice([0.0, 0.5, 1.0, 2.5, 1 / 3]) for _ in range(n)]
    overheads = {p: random.choice([0.0, 1e-9, 0.3, 1.0, 7.0]) for p in pairs}
    shares = [random.uniform(1, 3) for _ in range(blocks)]
    limits = [1.15 * s * sum(demands) / sum(shares) + 2.5 for s in shares]
    engine = Engine(tabulate(cut_problem(demands, overheads, limits)))
    greedy = engine.greedy()
    known = [] if -1 in greedy else greedy
    answer = engine.search(known, steps=steps, seed=seed)
    assert answer == engine.search(known, steps=steps, seed=seed)
    if known:
        assert cut(engine, answer) <= engine.total(known)
    elif answer.placed:
        assert engine.feasible(answer.placed)


def test_gives_up_when_nothing_fits() -> None:
    n, pairs = grid(400, Random(1))
    problem = cut_problem([1.0] * n, dict.fromkeys(pairs, 1.0), [199.0, 200.0])
    answer = Engine(tabulate(problem)).search([], steps=100_000)
    assert not answer.placed


def test_fills_to_the_last_place() -> None:
    n, pairs = grid(400, Random(1))
    problem = cut_problem([1.0] * n, dict.fromkeys(pairs, 1.0), [100.0] * 4)
    engine = Engine(tabulate(problem))
    answer = engine.search([], steps=100_000)
    # Four squares cut 40; of 760 connectors, placing at random would cut 570.
    assert cut(engine, answer) < 80
    assert [answer.placed.count(h) for h in range(4)] == [100] * 4


def test_counts_seconds_on_a_core_when_told_to() -> None:
    engine = even(*grid(400, Random(1)), 4)
    before = thread_time()
    engine.core.search([], 0.05, 1 << 62, 1, thread_time=True)
    assert thread_time() - before >= 0.05
