"""How long a proof of the optimum takes, against OR-Tools CP-SAT."""

from __future__ import annotations

from statistics import median

from benchmarks.placement.table import seconds, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError


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
            try:
                theirs = [plan.solve(p, limit, "cpsat", why=False) for p in robots[:2]]
            except UsageError:
                theirs = []
            rows.append([f"{n} x {m}", spread, *_cells(ours), *_cells(theirs)])
    show(
        f"Time to the proven optimum (at most {limit:g} s; 60 to 90 % load)",
        ["size", "spread", "`exact`", "proven", "`cpsat`", "proven"],
        rows,
    )
    return rows


def _cells(results: list[plan.Result]) -> list[str]:
    if not results:
        return ["not installed", "-"]
    proven = sum(result.proven for result in results)
    return [seconds(median(r.seconds for r in results)), f"{proven} of {len(results)}"]
