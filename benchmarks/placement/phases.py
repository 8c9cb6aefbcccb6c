"""Placements of a task's phases: F and time, against one problem for CP-SAT.

It imports internal modules: all phases as one problem are for comparisons only.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from random import Random
from time import perf_counter
from typing import Any

from msgspec.structs import replace

import poise
from benchmarks import cpsat
from benchmarks.placement.table import seconds, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.model.steps import Task
from poise.plan import _core
from poise.plan.phase_search import Unit, merged, weighted
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.problem.problem import Problem

SIZES = (
    (3, 12, 2, 0.5, 1.0),
    (5, 24, 3, 0.5, 1.0),
    (10, 60, 4, 0.2, 2.0),
    (10, 60, 4, 0.5, 1.0),
)
"""Phases, components, computers, which part of the components an action needs, and what
all of them need together of the robot's capacity."""
MOST = 0.8
"""No phase needs more of all computers together."""
Move = tuple[tuple[Unit, Unit], float]


def run(*, quick: bool) -> dict[str, Any]:
    """Return, for each size, F by Poise and by CP-SAT, and the time of each.

    CP-SAT gets far more time, and begins with what Poise found. Its bound is the higher
    one of that of the whole and the sum of those of the phases, which leaves out moves.
    """
    count, limit = (1, 5.0) if quick else (3, 30.0)
    rows, found = [], []
    for p, n, m, share, load in SIZES:
        for seed in range(count):
            robot = random_phases(seed, p, n, m, share, load)
            began = perf_counter()
            ours = poise.place(robot, "all").task_result
            spent = perf_counter() - began
            arrays, known = as_one(ours)
            theirs = cpsat.solve(_core.Core(arrays), arrays, limit, known)
            weights = ours.problem.weights
            alone = sum(
                weights[phase.name] * _bound(phase.problem, limit)
                for phase in ours.problem.phases
            )
            bound = max(theirs.bound, alone)
            assert ours.total is not None
            above, open_ = ours.total / theirs.objective - 1, ours.total / bound - 1
            found.append(
                {
                    "phases": p,
                    "components": n,
                    "computers": m,
                    "share": share,
                    "load": load,
                    "seed": seed,
                    "seconds": spent,
                    "total": ours.total,
                    "moves": len(ours.moves),
                    "cpsat": theirs.objective,
                    "cpsat_bound": bound,
                    "cpsat_proven": theirs.proven,
                    "cpsat_limit_s": limit,
                    "above_cpsat": above,
                    "above_bound": open_,
                }
            )
            rows.append(
                [
                    f"{p} x {n} x {m}, {share:.0%} of {load:.0%}",
                    seed,
                    seconds(spent),
                    f"{ours.total:.5f}",
                    len(ours.moves),
                    f"{theirs.objective:.5f}",
                    f"{above:+.2%}",
                    f"{bound:.5f}",
                    f"{open_:+.2%}",
                ]
            )
    show(
        "Placement of all phases of a task (phases x components x computers; which "
        "part of the components an action needs; what all need of the capacity)",
        ["size", "seed", "time", "F", "moves", "CP-SAT's", "above", "bound", "above"],
        rows,
    )
    return {"phases": found}


def random_phases(
    seed: int, phases: int, components: int, computers: int, share: float, load: float
) -> Robot:
    """Return a random robot whose task `all` has actions one after the other.

    Each needs about `share` of the functions, at most 80 % of the capacity.
    """
    random = Random(seed)
    problem = random_robot(seed, components, computers, load=load)
    items = list(problem.components)
    architectures: list[Architecture] = []
    while items:
        size = random.randint(3, 8)
        inside = tuple(
            ComponentEntry(name=item.name, demand=item.demand, only=item.only)
            for item in items[:size]
        )
        name = f"function{len(architectures)}"
        architectures.append(Architecture(name=name, function=name, components=inside))
        items = items[size:]
    robot = Robot(
        name="random",
        computers=problem.computers,
        architectures=tuple(architectures),
        connectors=tuple(
            Connector(
                between=(ConnectorEnd(edge.between[0]), ConnectorEnd(edge.between[1])),
                overhead=edge.overhead,
            )
            for edge in problem.connectors
        ),
        objective=problem.objective,
    )
    actions: list[Action] = []
    while len(actions) < phases:
        functions = tuple(a.name for a in architectures if random.random() < share)
        if not functions:
            continue
        part = plan.problem_of(robot, functions=functions)
        if _load(part) < MOST and plan.solve(part, 0.05, why=False).feasible:
            actions.append(Action(name=f"a{len(actions)}", functions=functions))
    return replace(robot, tasks=(Task(name="all", actions=tuple(actions)),))


def _bound(problem: Problem, limit: float) -> float:
    """Return what CP-SAT proves of one phase within a time [s]."""
    arrays = arrays_of(problem)
    known = arrays.placed(plan.solve(problem, why=False).placement)
    return cpsat.solve(_core.Core(arrays), arrays, limit, known).bound


def _load(problem: Problem) -> float:
    resources = ("cpu", "memory")
    return max(
        sum(c.demand[r] for c in problem.components)
        / sum(h.capacity[r] for h in problem.computers)
        for r in resources
    )


def as_one(result: plan.TaskResult) -> tuple[Arrays, Placed]:
    """Return phases one after the other as one problem, for CP-SAT, and a placement."""
    problem = result.problem
    weights = problem.weights
    parts = [
        weighted(arrays_of(phase.problem), weights[phase.name])
        for phase in problem.phases
    ]
    placements = [result.results[phase.name].placement for phase in problem.phases]
    known = [
        unit
        for part, placement in zip(parts, placements, strict=True)
        for unit in part.placed(placement)
    ]
    return merged(parts, dict(_moves(problem, parts))), known


def _moves(problem: plan.TaskProblem, parts: list[Arrays]) -> Iterator[Move]:
    for (p, one), (q, two) in pairwise(enumerate(parts)):
        for name in one.index.keys() & two.index.keys():
            move = problem.move_cost(name, 1.0, problem.lasts)
            yield ((p, one.index[name]), (q, two.index[name])), move
