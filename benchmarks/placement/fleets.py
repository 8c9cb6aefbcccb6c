"""How good a placement of a fleet is, and how long that takes."""

from __future__ import annotations

from benchmarks.placement.table import seconds, show
from benchmarks.random_robots import random_robot
from poise import plan

FLEETS = ((1_000, 20), (1_000, 100), (10_000, 100))
"""Components and computers."""
LOAD = 0.75
PINNED = (0.0, 0.02, 0.1)
BUDGET = 5.0


def run(*, quick: bool) -> list[list[str]]:
    """Return a row for each fleet: F by the greedy, and by `auto` in five seconds."""
    rows = []
    for n, m in FLEETS[:1] if quick else FLEETS:
        for pinned in PINNED:
            problem = random_robot(1, n, m, load=LOAD, pinned=pinned)
            greedy = plan.solve(problem, method="greedy")
            best = plan.solve(problem, BUDGET, why=False)
            rows.append(
                [
                    f"{n} x {m}",
                    f"{pinned:.0%}",
                    _total(greedy),
                    seconds(greedy.seconds),
                    _total(best),
                    seconds(best.seconds),
                ]
            )
    show(
        f"Fleets at {LOAD:.0%} load",
        ["size", "pinned", "F, greedy", "in", "F, `auto`", "in"],
        rows,
    )
    return rows


def _total(result: plan.Result) -> str:
    return "none" if result.objective is None else f"{result.objective.total:.4f}"
