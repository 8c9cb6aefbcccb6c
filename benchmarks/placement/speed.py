"""How long one decision takes, from Python, by every method in one table."""

from __future__ import annotations

from statistics import median
from timeit import repeat
from typing import Any

from benchmarks.placement.table import best_of, microseconds, quantile, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError
from poise.model import robot as model
from poise.plan.engine import Engine
from poise.plan.greedy import greedy
from poise.plan.tables import Tables, tabulate

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
        floor = [min(e.core.rehearse(20) for _ in range(50)) for e in engines]
        core = [min(repeat(e.greedy, number=20, repeat=50)) / 20 for e in engines]
        built = [best_of(lambda p=p: Engine(tabulate(p)), 30) for p in problems]  # type: ignore[misc]
        shot = [best_of(lambda r=r: _one_shot(r), 30) for r in robots]  # type: ignore[misc]
        checked = [
            best_of(lambda p=p: plan.solve(p, method="greedy"), 3)  # type: ignore[misc]
            for p in problems
        ]
        reference = [best_of(lambda t=t: greedy(t), 1) for t in tables[:3]]  # type: ignore[misc]
        cells = (floor, core, built, shot, checked, reference)
        proofs = _proof_cells(problems) if m == 2 else ["-", "-"]
        rows.append([f"{n} x {m}", *(microseconds(median(c)) for c in cells), *proofs])
    show(
        "One decision (median over robots)",
        [
            "components x computers",
            "greedy within C++",
            "greedy from Python, problem built once",
            "building the problem",
            "one shot by the greedy from the robot's records",
            "`plan.solve` by the greedy, checks and explanation included",
            "Python reference with trace",
            "greedy and proven optimum, problem built once",
            "CP-SAT, proven optimum",
        ],
        rows,
    )
    return rows


def _proof_cells(problems: list[plan.Problem]) -> list[str]:
    engines = [Engine(tabulate(problem)) for problem in problems]
    again = [best_of(lambda e=e: _prove(e), 20) for e in engines]  # type: ignore[misc]
    try:
        theirs = [plan.solve(p, 10.0, "cpsat").seconds for p in problems[:3]]
    except UsageError:
        return [microseconds(median(again)), "not installed"]
    return [microseconds(median(again)), microseconds(median(theirs))]


def _one_shot(robot: model.Robot) -> list[int]:
    return Engine(tabulate(plan.problem_of(robot))).greedy()


def _proofs(count: int) -> list[list[str]]:
    rows = []
    for load, name in ((0.6, "60 %"), (None, "60 to 90 %")):
        for spread in ("range", "variance"):
            firsts, times, ratios = [], [], []
            for seed in range(count):
                tables = tabulate(random_robot(seed, 24, 2, spread=spread, load=load))
                firsts.append(_first_proof(tables))
                engine = Engine(tables)
                times.append(best_of(lambda e=engine: _prove(e), 20))  # type: ignore[misc]
                start, answer = engine.greedy(), engine.exact([])
                if -1 not in start and answer.placed:
                    ratios.append(engine.total(start) / engine.total(answer.placed))
            for what, some in (("the first time", firsts), ("again", times)):
                within = sum(t < PAPER for t in some) / len(some)
                rows.append(
                    [
                        name,
                        spread,
                        what,
                        microseconds(median(some)),
                        microseconds(quantile(some, 0.95)),
                        f"{within:.0%}",
                        f"{median(ratios):.2f}",
                    ]
                )
    show(
        "Greedy and proven optimum, 24 components on 2 computers, problem built once",
        [
            "load",
            "spread",
            "proven",
            "median",
            "95 %",
            "under the paper's 42 us",
            "greedy / optimum",
        ],
        rows,
    )
    return rows


def _first_proof(tables: Tables) -> float:
    """Return how long it takes on a problem that was built and never proven before."""
    fresh = iter([Engine(tables) for _ in range(20)])
    return best_of(lambda: _prove(next(fresh)), 20)


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
