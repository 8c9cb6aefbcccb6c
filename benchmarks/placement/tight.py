"""Whether a placement of robots that are nearly full is found, and how soon."""

from __future__ import annotations

from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise import plan

SIZES = ((24, 4), (50, 6), (100, 8))
LOADS = (0.92, 0.95, 0.98)
BUDGETS = (0.1, 2.0)


def run(*, quick: bool) -> list[list[str]]:
    """Return a row for each size and load: how many of the robots were placed."""
    rows = []
    count = 3 if quick else 20
    for n, m in SIZES[:2] if quick else SIZES:
        for load in LOADS:
            robots = [
                random_robot(seed, n, m, load=load, uneven=True)
                for seed in range(count)
            ]
            found = [
                sum(plan.solve(p, budget, method, why=False).feasible for p in robots)
                for budget, method in ((0.0, "greedy"), *((b, "auto") for b in BUDGETS))
            ]
            rows.append([f"{n} x {m}", f"{load:.0%}", *map(str, found), str(count)])
    show(
        "Placements found of uneven robots that are nearly full",
        ["size", "load", "greedy", *(f"auto, {b:g} s" for b in BUDGETS), "of"],
        rows,
    )
    return rows
