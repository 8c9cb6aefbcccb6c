"""How long a decision takes through the public API, 24 components on 2 computers."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from timeit import repeat

from benchmarks.placement.table import show
from benchmarks.random_robots import random_robot
from poise import plan

SIZE = (24, 2)
PROOF_BUDGET = 10.0
"""Enough for every proof [s]."""


def run(*, quick: bool) -> dict[str, float]:
    """Return the median over robots of the best time of each, in microseconds."""
    robots = [random_robot(seed, *SIZE) for seed in range(12 if quick else 100)]
    times: dict[str, list[float]] = {}
    for problem in robots:
        for name, call in _calls(problem).items():
            times.setdefault(name, []).append(_best(call))
    medians = {name: round(median(some), 2) for name, some in times.items()}
    show(
        "One decision, 24 components on 2 computers (median over robots)",
        ["key of --json", "microseconds"],
        list(medians.items()),
    )
    return medians


def _calls(problem: plan.Problem) -> dict[str, Callable[[], object]]:
    planner = plan.Planner(problem)
    demands = {c.name: dict(c.demand) for c in problem.components}

    def update() -> None:
        planner.update(demands)
        planner.decide("greedy")

    return {
        "planner_greedy_us": lambda: planner.decide("greedy"),
        "planner_proven_us": lambda: planner.decide(budget=PROOF_BUDGET),
        "planner_update_us": update,
        "planner_build_us": lambda: plan.Planner(problem),
        "solve_us": lambda: plan.solve(problem, method="greedy"),
    }


def _best(call: Callable[[], object]) -> float:
    """Return the least time of a call [us]: what others do is only ever added."""
    return min(repeat(call, number=20, repeat=40)) / 20 * 1e6
