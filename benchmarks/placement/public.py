"""Public instances of the generalised quadratic assignment problem."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.placement.table import show
from poise.plan._core import Core


def run(folder: Path, *, quick: bool) -> list[list[Any]]:
    known = json.loads((folder / "best_known.json").read_text(encoding="utf-8"))
    budgets = (0.01, 0.1, 1.0) if quick else (0.01, 0.1, 1.0, 10.0)
    rows = []
    for name, value in known.items():
        core = read(folder / f"{name}.txt")
        gaps = []
        for budget in budgets:
            placed = core.search([], budget, 1 << 62, 1)[0]
            gap = 100 * (sum(core.terms(placed)) / value - 1) if placed else None
            gaps.append("none" if gap is None else f"{gap:.3f}")
        rows.append([name, value, *gaps])
    show(
        "Generalised quadratic assignment: gap to the best known value [%]",
        ["instance", "best known", *(f"{b:g} s" for b in budgets)],
        rows,
    )
    return rows


def read(path: Path) -> Core:
    """Return an instance; the traffic counts both ways, so each pair counts twice."""
    numbers = [float(word) for word in path.read_text(encoding="utf-8").split()]
    n, m, factor = int(numbers[0]), int(numbers[1]), numbers[2]
    at = 3
    traffic = numbers[at : at + n * n]
    at += n * n
    distance = numbers[at : at + m * m]
    at += m * m
    cost = numbers[at : at + n * m]
    at += n * m
    weight, capacity = numbers[at : at + n], numbers[at + n : at + n + m]
    pairs = [
        (i, j, traffic[i * n + j] + traffic[j * n + i])
        for i in range(n)
        for j in range(i)
        if traffic[i * n + j] + traffic[j * n + i] > 0
    ]
    return Core(
        n,
        m,
        1,
        weight,
        capacity,
        capacity,
        weight,
        [],
        [0],
        [],
        [i for i, _, _ in pairs],
        [j for _, j, _ in pairs],
        [w for _, _, w in pairs],
        [0.0 for _ in pairs],
        distance,
        cost,
        [],
        [],
        [],
        factor,
        [0.0],
        False,
        False,
    )
