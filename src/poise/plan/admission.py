"""When not all fits: which architectures to choose, and which to put aside.

Architectures of the same function are alternatives: one of them is chosen, quality
against fit (each unit of quality lost adds `Problem.quality` to F). When not all
functions fit, as few as possible are put aside, of the lowest priority first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations, product
from math import inf, prod

from msgspec.structs import replace

from poise.plan.change import keep_components
from poise.plan.problem import Architecture, Problem
from poise.plan.result import Result, Stopped

MOST_COMBINATIONS = 64
"""How many combinations of alternatives are tried; more are tried one change a time."""
MOST_DROPS = 256
"""How many sets of architectures of one priority are tried to be put aside."""

Decide = Callable[[Problem, float], Result]
"""Solves a problem with a share, in (0, 1], of the budget."""

Choice = tuple[Architecture, ...]


def alternatives(problem: Problem) -> dict[str, Choice]:
    """Return the functions that more than one architecture provides."""
    by_function: dict[str, list[Architecture]] = {}
    for a in problem.architectures:
        if a.function:
            by_function.setdefault(a.function, []).append(a)
    return {f: tuple(options) for f, options in by_function.items() if len(options) > 1}


def admit(problem: Problem, decide: Decide, *, fewer: bool) -> Result:
    """Choose among alternatives and, when `fewer`, put aside what does not fit."""
    needs = _needs(problem)
    result = _choose(problem, needs, decide, 0.7)
    if result.feasible or not fewer:
        return result
    admitted: list[Choice] = []
    for level in sorted({_priority(need) for need in needs}, reverse=True):
        at_level = [need for need in needs if _priority(need) == level]
        admitted += _largest(problem, admitted, at_level, decide)
    aside = tuple(a.name for need in needs if need not in admitted for a in need[:1])
    result = _choose(problem, admitted, decide, 1.0)
    return replace(result, aside=aside)


def part_of(problem: Problem, result: Result) -> Problem:
    """Return the problem without the architectures put aside or not chosen."""

    def need(a: Architecture) -> str:
        return a.function or f"\0{a.name}"

    aside = {need(a) for a in problem.architectures if a.name in result.aside}
    kept = tuple(
        a
        for a in problem.architectures
        if need(a) not in aside
        and result.architectures.get(a.function, a.name) == a.name
    )
    return _reduced(problem, kept)


def _needs(problem: Problem) -> list[Choice]:
    """Return what is to be provided: each by any one of several architectures."""
    groups: dict[str, list[Architecture]] = {}
    for a in problem.architectures:
        groups.setdefault(a.function or f"\0{a.name}", []).append(a)
    return [tuple(sorted(g, key=lambda a: -a.quality)) for g in groups.values()]


def _priority(need: Choice) -> int:
    return max(a.priority for a in need)


def _largest(
    problem: Problem, admitted: list[Choice], level: list[Choice], decide: Decide
) -> list[Choice]:
    """Return as many of a level as fit beside those admitted before."""
    tried = 0
    for dropped in range(len(level)):
        for out in combinations(range(len(level)), dropped):
            kept = [need for i, need in enumerate(level) if i not in out]
            if _choose(problem, admitted + kept, decide, 0.02).feasible:
                return kept
            tried += 1
            if tried >= MOST_DROPS:
                return _one_by_one(problem, admitted, level, decide)
    return []


def _one_by_one(
    problem: Problem, admitted: list[Choice], level: list[Choice], decide: Decide
) -> list[Choice]:
    kept: list[Choice] = []
    for need in level:
        if _choose(problem, [*admitted, *kept, need], decide, 0.02).feasible:
            kept.append(need)
    return kept


def _choose(
    problem: Problem, needs: list[Choice], decide: Decide, share: float
) -> Result:
    """Return the best result over the combinations of alternatives."""
    best: Result | None = None
    count = prod(len(need) for need in needs)
    combos: Iterator[Choice] = (
        product(*needs) if count <= MOST_COMBINATIONS else _one_change_each(needs)
    )
    tried = min(count, MOST_COMBINATIONS)
    bound: float | None = inf if count <= MOST_COMBINATIONS else None
    proven = count <= MOST_COMBINATIONS
    for combo in combos:
        lost = _quality_lost(needs, combo) * problem.quality
        result = _with_quality(
            decide(_reduced(problem, combo), share / max(1, tried)), lost, needs, combo
        )
        # What no combination is below, no placement is below.
        impossible = result.proven and not result.feasible
        if not impossible and bound is not None:
            bound = None if result.bound is None else min(bound, result.bound)
        proven = proven and result.proven
        if best is None or _better(result, best):
            best = result
        if result.stopped_by == "interrupted" and best.feasible:
            proven, bound = False, None
            break
    if best is None:
        return Result(placement={}, feasible=True)
    if count == 1:
        return best
    known = best.objective is not None and bound is not None
    return replace(
        best,
        bound=bound if known else None,
        proven=proven,
        stopped_by=_stopped(best, proven=proven),
    )


def _stopped(best: Result, *, proven: bool) -> Stopped:
    """Return why the choice among several ended, when the best ended as it did."""
    if proven:
        return "proven" if best.feasible else "infeasible"
    return "budget" if best.stopped_by in {"proven", "infeasible"} else best.stopped_by


def _one_change_each(needs: list[Choice]) -> Iterator[Choice]:
    first = tuple(need[0] for need in needs)
    yield first
    for i, need in enumerate(needs):
        for other in need[1:]:
            yield (*first[:i], other, *first[i + 1 :])


def _reduced(problem: Problem, combo: Choice) -> Problem:
    """Return the problem with the chosen architectures, and what belongs to none."""
    owned = {name for a in problem.architectures for name in a.components}
    chosen = {name for a in combo for name in a.components}
    free = {c.name for c in problem.components if c.name not in owned}
    return keep_components(problem, chosen | free)


def _quality_lost(needs: list[Choice], combo: Choice) -> float:
    return sum(
        max(a.quality for a in need) - chosen.quality
        for need, chosen in zip(needs, combo, strict=True)
    )


def _with_quality(
    result: Result, lost: float, needs: list[Choice], combo: Choice
) -> Result:
    picked = {
        chosen.function: chosen.name
        for need, chosen in zip(needs, combo, strict=True)
        if len(need) > 1
    }
    result = replace(result, architectures=picked)
    if result.objective is None or lost == 0:
        return result
    terms = replace(result.objective, total=result.objective.total + lost, quality=lost)
    bound = None if result.bound is None else result.bound + lost
    return replace(result, objective=terms, bound=bound)


def _better(result: Result, best: Result) -> bool:
    if result.feasible != best.feasible:
        return result.feasible
    if result.objective is None or best.objective is None:
        return False
    return result.objective.total < best.objective.total
