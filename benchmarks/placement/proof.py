"""How long a proof of the optimum takes, against OR-Tools CP-SAT."""

from __future__ import annotations

from statistics import median
from time import perf_counter

from benchmarks import cpsat
from benchmarks.placement.table import seconds, show
from benchmarks.random_robots import random_robot
from poise import plan


def run(*, quick: bool) -> list[list[str]]:
    """Return a row for each size and spread."""
    count, limit = (4, 5.0) if quick else (20, 30.0)
    rows = []
    for n, m in ((24, 2), (24, 3)) if quick else ((24, 2), (24, 3), (24, 4), (40, 2)):
        for spread in ("range", "variance"):
            robots = [
                random_robot(
                    seed, n, m, spread="range" if spread == "range" else "variance"
                )
                for seed in range(count)
            ]
            ours = [plan.solve(p, limit, "exact", why=False) for p in robots]
            theirs = [_certified(p, limit) for p in robots[:2]]
            times = [(r.seconds, r.proven) for r in ours]
            rows.append([f"{n} x {m}", spread, *_cells(times), *_cells(theirs)])
    show(
        f"Time to the proven optimum (at most {limit:g} s; 60 to 90 % load)",
        ["size", "spread", "`exact`", "proven", "CP-SAT", "proven"],
        rows,
    )
    return rows


def _certified(problem: plan.Problem, limit: float) -> tuple[float, bool]:
    """Return how long CP-SAT takes [s], and whether it proves its answer."""
    begin = perf_counter()
    proven = cpsat.certificate(problem, limit).proven
    return perf_counter() - begin, proven


def _cells(answers: list[tuple[float, bool]]) -> list[str]:
    proven = sum(is_proven for _, is_proven in answers)
    return [seconds(median(t for t, _ in answers)), f"{proven} of {len(answers)}"]
