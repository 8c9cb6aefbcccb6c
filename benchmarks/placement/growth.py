"""CPU time and memory against the numbers of components and computers: fleets."""

from __future__ import annotations

from collections.abc import Callable
from math import log
from pathlib import Path
from time import thread_time
from typing import Any

from benchmarks.placement.fleets import agents
from benchmarks.placement.table import best_of, microseconds, show

METHODS = ("greedy", "multilevel")

Point = dict[str, float]


def run(*, quick: bool) -> dict[str, Any]:
    sizes = [(1_000, 10), (10_000, 100), (100_000, 1_000)]
    if not quick:
        sizes.append((1_000_000, 1_000))
    by_components = [_point(n, m) for n, m in sizes]
    by_computers = [_point(100_000, m) for m in (10, 100, 1_000)]
    _table("Fleets", by_components)
    _table("Fleets of 100,000 components on more and more computers", by_computers)
    slopes = {
        f"{what} against {axis}": _slope(points, axis, what)
        for axis, points in (("components", by_components), ("computers", by_computers))
        for what in ("greedy_seconds", "multilevel_seconds", "peak")
    }
    for name, slope in slopes.items():
        print(f"{name.replace('_', ', ')}: grows to the power of {slope:.2f}")
    print()
    return {
        "components": by_components,
        "computers": by_computers,
        "slopes": slopes,
    }


def _table(title: str, points: list[Point]) -> None:
    show(
        title,
        [
            "components x computers",
            "greedy, CPU time",
            "F of the greedy",
            "multilevel, CPU time",
            "F of multilevel",
            "bytes a component: the problem",
            "with all that multilevel needs",
        ],
        [
            [
                f"{p['components']:,} x {p['computers']:,}",
                microseconds(p["greedy_seconds"]),
                f"{p['greedy']:.4f}",
                microseconds(p["multilevel_seconds"]),
                f"{p['multilevel']:.4f}",
                f"{p['bytes'] / p['components']:.0f}",
                f"{p['peak'] / p['components']:.0f}",
            ]
            for p in points
        ],
    )


def _point(n: int, m: int) -> Point:
    core = agents(n, m)
    times = 20 if n <= 10_000 else 5 if n <= 100_000 else 1
    more = _peak(lambda: core.multilevel(1))
    placed, better = core.greedy(), core.multilevel(1)
    return {
        "components": n,
        "computers": m,
        "greedy_seconds": best_of(core.greedy, times, thread_time),
        "greedy": sum(core.terms(placed)),
        "multilevel_seconds": best_of(lambda: core.multilevel(1), times, thread_time),
        "multilevel": sum(core.terms(better)),
        "bytes": core.bytes,
        "peak": core.bytes + more,
    }


def _peak(call: Callable[[], object]) -> float:
    """Return by how much this process grew at most [bytes] while `call` ran."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before = _memory("VmRSS")
    call()
    return max(0.0, _memory("VmHWM") - before)


def _memory(name: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(name):
            return 1024 * float(line.split()[1])
    return 0.0


def _slope(points: list[Point], axis: str, what: str) -> float:
    """Return the power by which it grows, from the first to the last point."""
    first, last = points[0], points[-1]
    return log(last[what] / max(first[what], 1e-12)) / log(last[axis] / first[axis])
