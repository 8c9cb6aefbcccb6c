"""Whether a feasible placement of tight, uneven robots is found, and how soon."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise.errors import UsageError
from poise.plan import cpsat
from poise.plan.engine import Engine
from poise.plan.tables import Tables, tabulate

SIZES = ((24, 4), (50, 6), (100, 8))
LOADS = (0.92, 0.95, 0.98, 0.99)
SOON, LONG = 0.01, 10.0


def run(*, quick: bool) -> list[list[Any]]:
    rows = []
    count = 5 if quick else 20
    for n, m in SIZES:
        for load in LOADS:
            found = {"greedy": 0, "soon": 0, "CP-SAT": 0, "known": 0, "none": 0}
            for seed in range(count):
                robot = random_robot(seed, n, m, load=load, uneven=True)
                for name in _found(tabulate(robot)):
                    found[name] += 1
            rows.append([f"{n} x {m}", f"{load:.0%}", *found.values(), count])
    show(
        "Feasible placements found of tight, uneven robots",
        [
            "components x computers",
            "load",
            "greedy",
            f"search {SOON:g} s",
            f"CP-SAT {LONG:g} s",
            "known to exist",
            "proven that none exists",
            "of",
        ],
        rows,
    )
    return rows


def _found(tables: Tables) -> set[str]:
    """Return who found a feasible placement, and whether there is one."""
    engine = Engine(tables)
    found = set()
    if -1 not in engine.greedy():
        found.add("greedy")
    if engine.search([], SOON, seed=1).placed:
        found.add("soon")
    try:
        # Without an objective it has nothing to do but to keep the limits.
        aimless = replace(tables, communication=0.0, spread=[0.0] * tables.r)
        oracle = cpsat.solve(aimless, LONG, seed=0)
    except UsageError:
        oracle = None
    if oracle is not None and oracle.placed:
        found.add("CP-SAT")
    if not found and oracle is not None and oracle.proven:
        found.add("none")
    elif found or engine.search([], LONG, seed=2).placed:
        found.add("known")
    return found
