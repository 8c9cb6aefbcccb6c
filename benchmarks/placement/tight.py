"""Whether a feasible placement of tight, uneven robots is found, and how soon."""

from __future__ import annotations

from typing import Any

from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

BUDGETS = (0.01, 0.1, 1.0)


def run(*, quick: bool) -> list[list[Any]]:
    rows = []
    count = 5 if quick else 20
    for n, m in ((24, 4), (50, 4), (100, 8)):
        for load in (0.9, 0.95, 0.98):
            found = dict.fromkeys(("greedy", *BUDGETS, "long"), 0)
            for seed in range(count):
                robot = random_robot(seed, n, m, load=load, uneven=True)
                engine = Engine(tabulate(robot))
                start = engine.greedy()
                found["greedy"] += -1 not in start
                for budget in BUDGETS:
                    placed = engine.search([], budget, seed=1).placed
                    found[budget] += bool(placed)
                long = engine.search([], 2.0 if quick else 10.0, seed=2).placed
                found["long"] += bool(long)
            rows.append([f"{n} x {m}", f"{load:.0%}", *found.values(), count])
    head = [f"in {b:g} s" for b in BUDGETS]
    show(
        "Feasible placements found of tight, uneven robots",
        ["components x computers", "load", "greedy", *head, "longest", "of"],
        rows,
    )
    return rows
