"""How good the answer is after a given time, against the best of all methods."""

from __future__ import annotations

from statistics import mean
from typing import Any

from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError
from poise.model.robot import Spread
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

BUDGETS = (1e-3, 1e-2, 1e-1, 1.0)
SIZES = ((24, 4), (50, 4), (100, 8))


SPREADS: tuple[Spread, ...] = ("range", "variance")


def run(*, quick: bool) -> list[list[Any]]:
    rows = []
    count = 3 if quick else 10
    for n, m in SIZES:
        for spread in SPREADS:
            gaps: dict[str, list[float]] = {}
            for seed in range(count):
                for name, gap in _gaps(n, m, spread, seed, quick=quick).items():
                    gaps.setdefault(name, []).append(gap)
            cells = [
                f"{mean(g):.2f}" if (g := gaps.get(name)) else "-" for name in _NAMES
            ]
            rows.append([f"{n} x {m}", spread, *cells])
    show(
        "Mean gap to the best known [%] (best of all methods and seeds)",
        ["components x computers", "spread", *_NAMES],
        rows,
    )
    return rows


_NAMES = ["greedy", *(f"search {b:g} s" for b in BUDGETS), "CP-SAT"]


def _gaps(
    n: int, m: int, spread: Spread, seed: int, *, quick: bool
) -> dict[str, float]:
    problem = random_robot(seed, n, m, spread=spread)
    engine = Engine(tabulate(problem))
    start = engine.greedy()
    known = [] if -1 in start else start
    found = {"greedy": known}
    for budget in BUDGETS:
        found[f"search {budget:g} s"] = engine.search(known, budget, seed=1).placed
    totals = {name: engine.total(x) for name, x in found.items() if x}
    long = [engine.search(known, 1.0 if quick else 3.0, seed=s).placed for s in (2, 3)]
    others = [engine.total(x) for x in long if x]
    if not quick and seed < 2:
        cpsat = _cpsat(problem)
        if cpsat is not None:
            totals["CP-SAT"] = cpsat
    least = min(*totals.values(), *others)
    return {name: 100 * (total / least - 1) for name, total in totals.items()}


def _cpsat(problem: plan.Problem) -> float | None:
    try:
        terms = plan.solve(problem, 60.0, "cpsat").objective
    except UsageError:
        return None
    return None if terms is None else terms.total
