"""Time and memory against the number of components: fleets."""

from __future__ import annotations

from math import log
from time import perf_counter
from typing import Any

from benchmarks.placement.fleets import fleet
from benchmarks.placement.table import best_of, microseconds, show

FOREVER = 1 << 62


def run(*, quick: bool) -> dict[str, Any]:
    sizes = [(1_000, 10), (10_000, 100), (100_000, 1_000)]
    if not quick:
        sizes.append((1_000_000, 1_000))
    points = [_point(n, m) for n, m in sizes]
    show(
        "Fleets",
        [
            "components x computers",
            "greedy",
            "F of the greedy",
            "multilevel",
            "F of multilevel",
            "bytes a component",
        ],
        [
            [
                f"{p['components']:,} x {p['computers']:,}",
                microseconds(p["greedy_seconds"]),
                f"{p['greedy']:.4f}",
                microseconds(p["multilevel_seconds"]),
                f"{p['multilevel']:.4f}",
                f"{p['bytes']:.0f}",
            ]
            for p in points
        ],
    )
    slope = _slope(points[0], points[2])
    print(f"multilevel: time grows as components to the power of {slope:.2f}\n")
    return {"points": points, "slope": slope}


def _point(n: int, m: int) -> dict[str, float]:
    core = fleet(n, m)
    start = perf_counter()
    placed = core.greedy()
    greedy_seconds = perf_counter() - start
    if n <= 10_000:
        greedy_seconds = best_of(core.greedy, 5)
    start = perf_counter()
    better = core.multilevel(1)
    seconds = perf_counter() - start
    return {
        "components": n,
        "computers": m,
        "greedy_seconds": greedy_seconds,
        "greedy": sum(core.terms(placed)),
        "multilevel_seconds": seconds,
        "multilevel": sum(core.terms(better)),
        "bytes": core.bytes / n,
    }


def _slope(small: dict[str, float], large: dict[str, float]) -> float:
    times = large["multilevel_seconds"] / small["multilevel_seconds"]
    return log(times) / log(large["components"] / small["components"])
