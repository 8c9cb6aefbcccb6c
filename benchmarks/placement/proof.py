"""How long a proof of the optimum takes, against OR-Tools CP-SAT."""

from __future__ import annotations

from statistics import median
from time import perf_counter
from typing import Any

from benchmarks.placement.table import microseconds, quantile, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError
from poise.model.robot import Spread
from poise.plan.engine import Engine
from poise.plan.tables import tabulate

SPREADS: tuple[Spread, ...] = ("range", "variance")


def run(*, quick: bool) -> list[list[Any]]:
    rows = []
    count, limit = (5, 5.0) if quick else (30, 30.0)
    for n, m in ((24, 2), (24, 3), (24, 4), (40, 2)):
        for spread in SPREADS:
            times, proven = [], 0
            for seed in range(count):
                engine = Engine(tabulate(random_robot(seed, n, m, spread=spread)))
                start = perf_counter()
                known = engine.search([], seconds=2e-3 if m > 2 else 2e-4).placed
                proven += engine.exact(known, seconds=limit).proven
                times.append(perf_counter() - start)
            theirs = _cpsat(n, m, spread, 2 if quick else 5, limit)
            rows.append(
                [
                    f"{n} x {m}",
                    spread,
                    microseconds(median(times)),
                    microseconds(quantile(times, 0.95)),
                    f"{proven} of {count}",
                    theirs,
                ]
            )
    show(
        f"Time to the proven optimum (limit {limit:.0f} s; 60 to 90 % load)",
        ["components x computers", "spread", "median", "95 %", "proven", "CP-SAT"],
        rows,
    )
    return rows


def _cpsat(n: int, m: int, spread: Spread, count: int, limit: float) -> str:
    times, proven = [], 0
    for seed in range(count):
        robot = random_robot(seed, n, m, spread=spread)
        try:
            result = plan.solve(robot, limit, "cpsat")
        except UsageError:
            return "not installed"
        times.append(result.seconds)
        proven += result.proven
    return f"{microseconds(median(times))}, {proven} of {count}"
