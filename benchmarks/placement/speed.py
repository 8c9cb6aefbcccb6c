"""How long one decision takes, from Python, by every method in one table."""

from __future__ import annotations

from statistics import median
from timeit import repeat
from typing import Any

from benchmarks.placement.table import best_of, microseconds, quantile, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.model import robot as model
from poise.plan.engine import Engine
from poise.plan.greedy import greedy
from poise.plan.tables import tabulate

PAPER = 42e-6
"""How long the paper's greedy takes for 24 components on 2 computers [s]."""


def run(*, quick: bool) -> dict[str, Any]:
    report: dict[str, Any] = {"decisions": _decisions(10 if quick else 100)}
    report["proofs"] = _proofs(20 if quick else 200)
    return report


def _decisions(count: int) -> list[list[str]]:
    rows = []
    for n, m in ((24, 2), (24, 4), (200, 8)):
        problems = [random_robot(seed, n, m) for seed in range(count)]
        tables = [tabulate(problem) for problem in problems]
        engines = [Engine(t) for t in tables]
        robots = [as_robot(problem) for problem in problems]
        core = [min(repeat(e.greedy, number=20, repeat=50)) / 20 for e in engines]
        reference = [best_of(lambda t=t: greedy(t), 1) for t in tables[:3]]  # type: ignore[misc]
        built = [best_of(lambda p=p: Engine(tabulate(p)), 5) for p in problems]  # type: ignore[misc]
        shot = [best_of(lambda r=r: _one_shot(r), 5) for r in robots]  # type: ignore[misc]
        checked = [
            best_of(lambda p=p: plan.solve(p, method="greedy"), 3)  # type: ignore[misc]
            for p in problems
        ]
        cells = (core, built, shot, checked, reference)
        rows.append([f"{n} x {m}", *(microseconds(median(c)) for c in cells)])
    show(
        "One decision by the greedy (median over robots)",
        [
            "components x computers",
            "core, problem built once",
            "building the problem",
            "one shot from the robot's records",
            "`plan.solve`, checks and explanation included",
            "Python reference with trace",
        ],
        rows,
    )
    return rows


def _one_shot(robot: model.Robot) -> list[int]:
    return Engine(tabulate(plan.problem_of(robot))).greedy()


def _proofs(count: int) -> list[list[str]]:
    rows = []
    for load, name in ((0.6, "60 %"), (None, "60 to 90 %")):
        for spread in ("range", "variance"):
            times, ratios = [], []
            for seed in range(count):
                engine = Engine(
                    tabulate(random_robot(seed, 24, 2, spread=spread, load=load))
                )
                times.append(best_of(lambda e=engine: _prove(e), 20))  # type: ignore[misc]
                start, answer = engine.greedy(), engine.exact([])
                if -1 not in start and answer.placed:
                    ratios.append(engine.total(start) / engine.total(answer.placed))
            within = sum(t < PAPER for t in times) / len(times)
            rows.append(
                [
                    name,
                    spread,
                    microseconds(median(times)),
                    microseconds(quantile(times, 0.95)),
                    f"{within:.0%}",
                    f"{median(ratios):.2f}",
                ]
            )
    show(
        "Greedy and proven optimum, 24 components on 2 computers, problem built once",
        [
            "load",
            "spread",
            "median",
            "95 %",
            "under the paper's 42 us",
            "greedy / optimum",
        ],
        rows,
    )
    return rows


def _prove(engine: Engine) -> None:
    start = engine.greedy()
    engine.exact([] if -1 in start else start)


def as_robot(problem: plan.Problem) -> model.Robot:
    """Return the robot whose problem this is, as the model's records."""
    architecture = model.Architecture(
        name="all",
        function="all",
        components=tuple(
            model.Component(name=c.name, demand=c.demand, only=c.only)
            for c in problem.components
        ),
        connectors=tuple(
            model.Connector(
                between=(model.End(k.between[0]), model.End(k.between[1])),
                overhead=k.overhead,
            )
            for k in problem.connectors
        ),
    )
    return model.Robot(
        name="random",
        computers=tuple(
            model.Computer(name=h.name, capacity=h.capacity) for h in problem.computers
        ),
        architectures=(architecture,),
        objective=problem.objective,
    )
