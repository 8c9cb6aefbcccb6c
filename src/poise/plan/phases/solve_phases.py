"""Places the phases of a task so that little moves between them.

Each phase is placed alone first: where nothing moves then, that is the best. Else each
is placed with what it costs to be elsewhere than in the phases beside it, forwards and
backwards; then, until the time is over, phases beside each other are placed as one
problem, which `merged` makes of them.
"""

from __future__ import annotations

from math import inf
from time import perf_counter

from poise.plan.phases.phase_problem import PhasedProblem
from poise.plan.phases.phase_result import PhasedResult
from poise.plan.phases.phase_search import PhaseSearch
from poise.plan.planner import BUDGET
from poise.plan.result_records import Ask
from poise.plan.solvers.portfolio import Budget, Effort

PHASES_BUDGET = 0.26
"""How long to search by default where there are several phases [s]: with all around it,
0.3 s for 60 components."""
GAIN = 1e-9
"""F that is lower by less is not better: rounding only."""


def solve_phases(  # noqa: PLR0913 - each says how to decide, and has a default
    problem: PhasedProblem,
    budget: float | None = None,
    method: str = "auto",
    seed: int = 0,
    *,
    steps: int | None = None,
    fewer: bool = False,
    stop: Ask | None = None,
    why: bool = True,
) -> PhasedResult:
    """Return the best placements of all phases found within `budget` [s].

    The parameters are those of `poise.plan.solve`; the budget is 0.1 s unless given,
    and 0.26 s for several phases. A method other than ``auto`` and
    ``search`` places one phase after the other only. A phase in which nothing was
    found, though there may be something, gets the whole budget once.
    """
    begin = perf_counter()
    if budget is None:
        budget = BUDGET if len(problem.phases) == 1 else PHASES_BUDGET
    until = Budget(budget)
    search = PhaseSearch(
        problem, method, Effort(budget, steps, seed, stop), fewer=fewer
    )
    alone = search.alone()
    result = PhasedResult(problem, alone)
    weights = problem.weights
    bounds = [
        weights[name] * each.bound
        for name, each in alone.items()
        if each.bound is not None
    ]
    bound = sum(bounds) if len(bounds) == len(alone) else None
    if result.moves:
        held = {name: each for name, each in alone.items() if each.feasible}
        better = search.chained(held, until.left)
        if method in {"auto", "search"}:
            enough = -inf if bound is None else bound + GAIN
            better = search.together(better, until.left, enough)
        if search.total(better) < search.total(held) - GAIN:
            changed = {
                name: each
                for name, each in better.items()
                if each.placement != alone[name].placement
            }
            result = PhasedResult(problem, {**alone, **changed})
    if why and method != "greedy":
        for each in result.results.values():
            each.find_conflict(stop)
    if not result.feasible:
        result.proven = any(r.proven for r in alone.values() if not r.feasible)
    elif bound is not None and result.total is not None:
        # Nothing is below phases that do without moves.
        result.bound = min(bound, result.total)
        result.proven = result.total <= bound + GAIN
    if search.interrupted:
        result.stopped_by = "interrupted"
    result.seconds = perf_counter() - begin
    return result
