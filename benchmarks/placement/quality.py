"""How good the answer is after a given time, against the best of all methods."""

from __future__ import annotations

from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.placement.reference import CPSAT, SEARCH, Reference, reference
from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import Spread
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

BUDGETS = (1e-3, 1e-2, 1e-1, 1.0)
SIZES = ((24, 4), (50, 4), (100, 8))
SPREADS: tuple[Spread, ...] = ("range", "variance")

_NAMES = [
    "greedy",
    *(f"search {b:g} s" for b in BUDGETS),
    *(f"auto {b:g} s" for b in BUDGETS[1:3]),
    f"CP-SAT {CPSAT:g} s",
]


def run(count: int, folder: Path) -> list[list[Any]]:
    """Print how far each method is from the best known, over `count` robots a row.

    The best known comes from runs of minutes, kept in `folder`.
    """
    rows = []
    for n, m in SIZES:
        for spread in SPREADS:
            robots = [random_robot(seed, n, m, spread=spread) for seed in range(count)]
            known = [reference(robot, folder) for robot in robots]
            gaps: dict[str, list[float]] = {}
            for robot, best in zip(robots, known, strict=True):
                for name, gap in _gaps(robot, best).items():
                    gaps.setdefault(name, []).append(gap)
            cells = [
                "-" if not (g := gaps.get(name)) else _cell(g, count) for name in _NAMES
            ]
            proven = sum(
                best.ours.proven or (best.cpsat is not None and best.cpsat.proven)
                for best in known
            )
            rows.append([f"{n} x {m}", spread, *cells, f"{proven} of {count}"])
    show(
        f"Mean gap to the best known [%], {count} robots a row (best of all methods "
        f"here and {SEARCH:g} s of search; CP-SAT with one worker)",
        ["components x computers", "spread", *_NAMES, "best known is proven"],
        rows,
    )
    return rows


def _cell(gaps: list[float], count: int) -> str:
    found = "" if len(gaps) == count else f" ({len(gaps)} of {count} found)"
    return f"{mean(gaps):.2f}{found}"


def _gaps(problem: plan.Problem, best: Reference) -> dict[str, float]:
    engine = Engine(tabulate(problem))
    start = engine.greedy()
    known = [] if -1 in start else start
    found = {"greedy": known}
    for budget in BUDGETS:
        found[f"search {budget:g} s"] = engine.search(known, budget, seed=1).placed
    if best.cpsat is not None:
        found[f"CP-SAT {CPSAT:g} s"] = best.cpsat.placed
    totals = {name: engine.total(x) for name, x in found.items() if x}
    for budget in BUDGETS[1:3]:
        terms = plan.solve(problem, budget, why=False).objective
        if terms is not None:
            totals[f"auto {budget:g} s"] = terms.total
    least = min(*totals.values(), engine.total(best.ours.placed))
    return {name: 100 * (total / least - 1) for name, total in totals.items()}
