"""How good the answer is after a given effort, against the best of all methods.

The effort is in steps, so that a busy machine changes nothing; how much CPU time the
steps take is in the table.
"""

from __future__ import annotations

from pathlib import Path
from statistics import mean
from time import process_time
from typing import Any

from benchmarks.placement.reference import CPSAT, SEARCH, Reference, reference
from benchmarks.placement.table import microseconds, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import Spread
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

STEPS = (2_500, 25_000, 250_000)
SIZES = ((24, 4), (50, 4), (100, 8))
SPREADS: tuple[Spread, ...] = ("range", "variance")

_NAMES = [
    "greedy",
    *(f"search, {steps:,} steps" for steps in STEPS),
    *(f"auto, {steps:,} steps" for steps in STEPS[1:]),
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
            times: dict[str, list[float]] = {}
            for robot, best in zip(robots, known, strict=True):
                for name, gap in _gaps(robot, best, times).items():
                    gaps.setdefault(name, []).append(gap)
            cells = [
                _cell(gaps.get(name, []), times.get(name), count) for name in _NAMES
            ]
            proven = sum(
                best.ours.proven or (best.cpsat is not None and best.cpsat.proven)
                for best in known
            )
            rows.append([f"{n} x {m}", spread, *cells, f"{proven} of {count}"])
    show(
        f"Mean gap to the best known [%], {count} robots a row (best of all methods "
        f"here and {SEARCH:,} steps of search; CP-SAT with one worker), and CPU time",
        ["components x computers", "spread", *_NAMES, "best known is proven"],
        rows,
    )
    return rows


def _cell(gaps: list[float], times: list[float] | None, count: int) -> str:
    if not gaps:
        return "-"
    found = "" if len(gaps) == count else f", {len(gaps)} of {count} found"
    took = f" ({microseconds(mean(times))})" if times else ""
    return f"{mean(gaps):.2f}{took}{found}"


def _gaps(
    problem: plan.Problem, best: Reference, times: dict[str, list[float]]
) -> dict[str, float]:
    engine = Engine(tabulate(problem))
    start = engine.greedy()
    known = [] if -1 in start else start
    totals = {"greedy": engine.total(known)} if known else {}
    for steps in STEPS:
        name = f"search, {steps:,} steps"
        begin = process_time()
        placed = engine.search(known, steps=steps, seed=1).placed
        times.setdefault(name, []).append(process_time() - begin)
        if placed:
            totals[name] = engine.total(placed)
    for steps in STEPS[1:]:
        name = f"auto, {steps:,} steps"
        begin = process_time()
        terms = plan.solve(problem, steps=steps, why=False).objective
        times.setdefault(name, []).append(process_time() - begin)
        if terms is not None:
            totals[name] = terms.total
    if best.cpsat is not None and best.cpsat.placed:
        totals[f"CP-SAT {CPSAT:g} s"] = engine.total(best.cpsat.placed)
    least = min(*totals.values(), engine.total(best.ours.placed))
    return {name: 100 * (total / least - 1) for name, total in totals.items()}
