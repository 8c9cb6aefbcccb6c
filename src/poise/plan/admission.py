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
"""How many sets of architectures are tried, before they are tried one by one."""

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
    priorities = sorted({_priority(need) for need in needs}, reverse=True)
    levels = [[need for need in needs if _priority(need) == p] for p in priorities]
    admitted = _Admission(problem, decide).most([], levels)
    aside = tuple(a.name for need in needs if need not in admitted for a in need[:1])
    best = _choose(problem, admitted, decide, 1.0)
    # What fits when some are put aside does not say why they were: all together do.
    reason = result.reason if best.feasible and aside else best.reason
    return replace(best, aside=aside, reason=reason)


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


class _Admission:
    """Finds what to keep: as many as possible of the first level, then of the next."""

    def __init__(self, problem: Problem, decide: Decide) -> None:
        self._problem = problem
        self._decide = decide
        self._tried = 0

    def most(self, admitted: list[Choice], levels: list[list[Choice]]) -> list[Choice]:
        """Return what fits of these levels, beside those admitted before."""
        if not levels:
            return admitted
        level, lower = levels[0], levels[1:]
        best: list[Choice] | None = None
        for dropped in range(len(level) + 1):
            for out in combinations(range(len(level)), dropped):
                if self._tried >= MOST_DROPS:
                    return best or self.most(self._one_by_one(admitted, level), lower)
                kept = [need for i, need in enumerate(level) if i not in out]
                if kept and not self._fits(admitted + kept):
                    continue
                # Of as many of this level, those that leave the most to lower ones.
                whole = self.most(admitted + kept, lower)
                if best is None or _counts(whole, lower) > _counts(best, lower):
                    best = whole
                if _counts(best, lower) == [len(each) for each in lower]:
                    return best
            if best is not None:
                return best
        return admitted

    def _one_by_one(self, admitted: list[Choice], level: list[Choice]) -> list[Choice]:
        for need in level:
            if self._fits([*admitted, need]):
                admitted = [*admitted, need]
        return admitted

    def _fits(self, needs: list[Choice]) -> bool:
        self._tried += 1
        return _choose(self._problem, needs, self._decide, 0.02).feasible


def _counts(admitted: list[Choice], levels: list[list[Choice]]) -> list[int]:
    """Return how many of each level are among those admitted."""
    return [sum(need in admitted for need in level) for level in levels]


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
