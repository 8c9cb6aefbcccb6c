"""Placements of a task's phases: F and time, against one problem for CP-SAT.

It imports internal modules: all phases as one problem are for comparisons only.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from random import Random
from typing import Any

from benchmarks.placement.table import seconds, show
from benchmarks.random_robots import random_robot
from poise import plan
from poise.plan import _core
from poise.plan.phases.merged import Unit, merged
from poise.plan.phases.problem import MOVE, PhasedProblem, PhaseProblem
from poise.plan.problem.arrays import Arrays, arrays_of
from poise.plan.problem.problem import Problem

SIZES = ((3, 12, 2), (5, 24, 3), (10, 60, 4))
"""Phases, components and computers."""
BUDGET = 0.3
Move = tuple[tuple[Unit, Unit], float]


def run(*, quick: bool) -> dict[str, Any]:
    """Return, for each size, F by Poise and by CP-SAT, and the time of each."""
    try:
        from poise.plan.solvers import cpsat  # noqa: PLC0415 - an extra
    except ImportError:
        return {"phases": "CP-SAT is not installed"}
    count, limit = (1, 5.0) if quick else (5, 60.0)
    rows, found = [], []
    for p, n, m in SIZES:
        for seed in range(count):
            problem = random_phases(seed, p, n, m)
            ours = plan.solve_phases(problem, BUDGET, why=False)
            arrays = as_one(problem)
            core = _core.Core(arrays)
            theirs = cpsat.solve(core, arrays, limit, seed, [])
            assert ours.total is not None
            above = ours.total / theirs.objective - 1
            found.append(
                {
                    "phases": p,
                    "components": n,
                    "computers": m,
                    "seed": seed,
                    "seconds": ours.seconds,
                    "total": ours.total,
                    "moves": len(ours.moves),
                    "bound": ours.bound,
                    "cpsat": theirs.objective,
                    "cpsat_proven": theirs.proven,
                    "cpsat_limit_s": limit,
                    "above_cpsat": above,
                }
            )
            rows.append(
                [
                    f"{p} x {n} x {m}",
                    seed,
                    seconds(ours.seconds),
                    f"{ours.total:.5f}",
                    f"{theirs.objective:.5f}",
                    "yes" if theirs.proven else f"no, in {limit:g} s",
                    f"{above:+.2%}",
                ]
            )
    show(
        "Placement of all phases of a task (phases x components x computers)",
        ["size", "seed", "time", "F, all phases", "CP-SAT's", "proven", "above"],
        rows,
    )
    return {"phases": found}


def random_phases(
    seed: int, phases: int, components: int, computers: int
) -> PhasedProblem:
    """Return a task's phases one after the other, on a random robot.

    Each needs about half of its groups of components, at most 80 % of the capacity.
    """
    random = Random(seed)
    robot = random_robot(seed, components, computers, load=1.0)
    names = [component.name for component in robot.components]
    groups = []
    while names:
        size = random.randint(3, 8)
        groups.append(names[:size])
        names = names[size:]
    parts: list[Problem] = []
    while len(parts) < phases:
        kept = {name for g in groups if random.random() < 0.5 for name in g}
        part = plan.keep_components(robot, kept)
        if kept and _load(part) < 0.8 and plan.solve(part, 0.05, why=False).feasible:
            parts.append(part)
    return PhasedProblem(
        phases=tuple(
            PhaseProblem(name=f"p{i}", problem=part, after=(f"p{i - 1}",) if i else ())
            for i, part in enumerate(parts)
        ),
        move={component.name: MOVE for component in robot.components},
    )


def _load(problem: Problem) -> float:
    resources = ("cpu", "memory")
    return max(
        sum(c.demand[r] for c in problem.components)
        / sum(h.capacity[r] for h in problem.computers)
        for r in resources
    )


def as_one(problem: PhasedProblem) -> Arrays:
    """Return phases one after the other as one problem, for CP-SAT."""
    parts = [arrays_of(phase.problem) for phase in problem.phases]
    return merged(parts, dict(_moves(problem, parts)))


def _moves(problem: PhasedProblem, parts: list[Arrays]) -> Iterator[Move]:
    for (p, one), (q, two) in pairwise(enumerate(parts)):
        for name in one.index.keys() & two.index.keys():
            yield ((p, one.index[name]), (q, two.index[name])), problem.move[name]
