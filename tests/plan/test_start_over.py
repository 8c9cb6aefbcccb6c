"""With few components a computer, many short searches each begin at the same start."""

import pytest

from benchmarks.random_robots import random_robot
from poise.model.robot import Spread
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

FEW = (18, 4)
"""Components and computers: fewer than six a computer, so that search starts over."""


@pytest.mark.parametrize("spread", ["range", "variance"])
@pytest.mark.parametrize("seed", [1, 4, 8])
def test_many_short_searches_find_the_proven_optimum(seed: int, spread: Spread) -> None:
    engine = Engine(tabulate(random_robot(seed, *FEW, spread=spread, load=0.6)))
    optimum = engine.exact([])
    found = engine.search([], steps=150_000, seed=3)
    assert optimum.proven
    assert engine.total(found.placed) == pytest.approx(optimum.bound, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_what_was_known_is_kept_though_each_search_forgets_it(seed: int) -> None:
    engine = Engine(tabulate(random_robot(seed, *FEW, load=0.6)))
    optimum = engine.exact([])
    kept = engine.search(optimum.placed, steps=20_000, seed=seed)
    assert engine.feasible(kept.placed)
    assert engine.total(kept.placed) == pytest.approx(optimum.bound, rel=1e-9)


@pytest.mark.slow
def test_the_best_of_all_short_searches_is_returned() -> None:
    """Each is short: what the last one ends at is rarely the best."""
    engine = Engine(tabulate(random_robot(2, 40, 8, load=0.6)))
    totals = [
        engine.total(engine.search([], steps=steps, seed=5).placed)
        for steps in (20_000, 60_000, 180_000)
    ]
    optimum = min(engine.total(engine.search([], steps=600_000).placed), *totals)
    assert totals[-1] <= optimum * 1.05
    assert totals[-1] <= totals[0] + 1e-9
