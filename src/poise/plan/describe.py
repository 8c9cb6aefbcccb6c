"""A placement -> a result with all that follows from it."""

from __future__ import annotations

from collections.abc import Mapping

from poise.errors import UsageError
from poise.plan import objective
from poise.plan.check import check
from poise.plan.limits import tightest, violations
from poise.plan.problem import Problem
from poise.plan.result import Result
from poise.plan.tables import Placed, Tables, tabulate


def evaluate(
    problem: Problem, placement: Mapping[str, str], method: str = "given"
) -> Result:
    """Return what can be said of a given placement, feasible or not.

    Raises
    ------
    RobotError
        When the problem is wrong.
    UsageError
        When a component has no computer, or one that is not there, or components that
        must share a computer do not.
    """
    check(problem)
    tables = tabulate(problem)
    return described(tables, placed_by_name(tables, placement), method=method)


def placed_by_name(tables: Tables, placement: Mapping[str, str]) -> Placed:
    """Return a placement by name as one by index; raises as `evaluate` does."""
    problem = tables.problem
    index = {h.name: i for i, h in enumerate(problem.computers)}
    placed = [-1] * tables.n
    for i, component in enumerate(problem.components):
        name = placement.get(component.name)
        if name not in index:
            choices = ", ".join(index)
            raise UsageError(
                f"component {component.name!r} is placed on {name!r} "
                f"(there are: {choices})"
            )
        unit = tables.unit_of[i]
        if placed[unit] not in {-1, index[name]}:
            names = [problem.components[j].name for j in tables.members[unit]]
            raise UsageError(f"{', '.join(names)} must share a computer")
        placed[unit] = index[name]
    return placed


def described(tables: Tables, placed: Placed, **known: object) -> Result:
    """Return the result for a complete placement; `known` are further fields of it.

    A bound that rounding has put above F is F.
    """
    problem = tables.problem
    load = objective.loads(tables, placed)
    terms = objective.terms(tables, placed)
    broken = violations(tables, placed, load)
    fields: dict[str, object] = {
        "placement": {
            c.name: problem.computers[placed[tables.unit_of[i]]].name
            for i, c in enumerate(problem.components)
        },
        "feasible": not broken,
        "reason": "; ".join(broken),
        "objective": terms,
        "tightest": tightest(tables, load),
        "scale": problem.objective.scale,
        "spread": problem.objective.spread,
    }
    bound = known.get("bound")
    if isinstance(bound, float) and not broken:
        known["bound"] = min(bound, terms.total)
    return Result(**(fields | known))  # type: ignore[arg-type]
