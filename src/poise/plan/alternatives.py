"""When not all fits: which architectures to choose, and which to suspend.

Architectures of the same function are alternatives: exactly one of them is chosen,
quality against fit (each unit of quality lost adds `Objective.quality` to F). When not
all functions fit, as few as possible are suspended, of the lowest priority first; never
one that is required.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from itertools import combinations, product
from math import inf, prod

from poise.errors import UsageError
from poise.model.hardware import fits
from poise.plan.problem.changed_problem import keep_components
from poise.plan.problem.items import Bundle
from poise.plan.problem.problem import Need, Problem, needs
from poise.plan.result import Result
from poise.plan.result_records import Selection

MOST_COMBINATIONS = 64
"""How many combinations of alternatives are tried; more are tried one change a time."""
MOST_EXPLAINED = 8
"""Of no more combinations the way out is looked for in each, where nothing holds."""
MOST_DROPS = 256
"""How many sets of architectures are tried, before they are tried one by one."""

Decide = Callable[[frozenset[str], float], Result]
"""Decides some components with a share, in (0, 1], of the effort."""


def has_choice(problem: Problem) -> bool:
    """Whether more than one architecture provides some function."""
    return len(needs(problem)) < len(problem.architectures)


def members(problem: Problem, bundles: Iterable[Bundle]) -> frozenset[str]:
    """Return the components of these architectures, and of none."""
    owned = {name for bundle in problem.architectures for name in bundle.components}
    chosen = {name for bundle in bundles for name in bundle.components}
    return frozenset(
        c.name for c in problem.components if c.name in chosen or c.name not in owned
    )


def part(problem: Problem, bundles: Iterable[Bundle]) -> Problem:
    """Return the problem with these architectures, and what belongs to none."""
    return keep_components(problem, members(problem, bundles))


def chosen_by(
    problem: Problem, placement: Mapping[str, str], *, partial: bool = False
) -> tuple[Selection, Problem]:
    """Return what a placement chooses, and the problem without the rest."""
    if not (has_choice(problem) or partial):
        return Selection(), problem
    every, combo = needs(problem), []
    if partial:
        every = [
            need
            for need in every
            if placement.keys() & {name for b in need for name in b.components}
        ]
    for need in every:
        placed = [
            b for b in need if b.components and placement.keys() >= {*b.components}
        ]
        # the best without components is chosen where no other is
        placed = placed or [b for b in need if not b.components][:1]
        if len(need) > 1 and len(placed) != 1:
            names = ", ".join(bundle.name for bundle in need)
            has = ", ".join(bundle.name for bundle in placed) or "none"
            raise UsageError(
                f"of {names}, which provide {need[0].function!r}, a placement has "
                f"exactly one; this one has {has}"
            )
        combo.append(placed[0] if len(need) > 1 else need[0])
    return _choice(problem, every, tuple(combo)), part(problem, combo)


def without(problem: Problem, suspended: Collection[str]) -> Problem:
    """Return the problem without functions; their first architectures name them."""
    kept = [need for need in needs(problem) if need[0].name not in suspended]
    return part(problem, [bundle for need in kept for bundle in need])


def admit(problem: Problem, decide: Decide, *, fewer: bool) -> Result:
    """Choose among alternatives and, when `fewer`, suspend what does not fit."""
    every = needs(problem)
    result = _choose(problem, every, decide, 0.7)
    if result.feasible:
        return result
    others = tuple(_other_parts(problem, every, result.choice))
    result.choice = result.choice._replace(others=others)
    required = [need for need in every if any(b.required for b in need)]
    optional = [need for need in every if need not in required]
    if not (fewer and optional):
        return result
    priorities = sorted({_priority(need) for need in optional}, reverse=True)
    levels = [[n for n in optional if _priority(n) == p] for p in priorities]
    admission = _Admission(problem, decide)
    sets = admission.most(required, levels)
    results = [_choose(problem, kept, decide, 1.0 / len(sets)) for kept in sets]
    best, admitted = results[0], sets[0]
    for other, kept in zip(results[1:], sets[1:], strict=True):
        if _better(other, best):
            best, admitted = other, kept
    if best.feasible and (len(sets) > 1 or not admission.is_complete):
        bounds = [-inf if result.bound is None else result.bound for result in results]
        proven = all(result.proven for result in results)
        best.settle(
            min(bounds) if admission.is_complete else -inf,
            proven=proven and admission.is_complete,
        )
    suspended = tuple(need[0].name for need in every if need not in admitted)
    if suspended:
        whole = result.problem if others or not result.choice.architectures else None
        best.choice = best.choice._replace(
            suspended=suspended, whole=whole, why=result.reason, others=others
        )
    return best


def _other_parts(
    problem: Problem, every: list[Need], chosen: Selection
) -> Iterator[Problem]:
    """Yield the problems with other alternatives, unless those are too many."""
    if prod(len(need) for need in every) <= MOST_EXPLAINED:
        for combo in product(*every):
            other = _choice(problem, every, combo)
            if other.architectures != chosen.architectures:
                yield part(problem, combo)


def _priority(need: Need) -> int:
    return max(bundle.priority for bundle in need)


def given_up(problem: Problem, suspended: Collection[str]) -> list[int]:
    """Return the priorities of what is suspended, highest first; less is better."""
    gone = (need for need in needs(problem) if need[0].name in suspended)
    return sorted(map(_priority, gone), reverse=True)


class _Admission:
    """Finds what to keep: as many as possible of the first level, then of the next."""

    def __init__(self, problem: Problem, decide: Decide) -> None:
        self._problem = problem
        self._decide = decide
        self._tried = 0
        self.is_complete = True
        # each of those that share a component counts its part of it
        sharing = Counter(name for b in problem.architectures for name in b.components)
        self._demand = {
            c.name: {r: x / max(1, sharing[c.name]) for r, x in c.demand.items()}
            for c in problem.components
        }
        resources = {r for h in problem.computers for r in h.capacity}
        resources -= {limit.resource for limit in problem.soft_limits}
        self._usable = {
            r: sum(h.usable(r) for h in problem.computers) for r in resources
        }

    def most(self, admitted: list[Need], levels: list[list[Need]]) -> list[list[Need]]:
        """Return all that is equally good to keep, beside those admitted before."""
        if not levels:
            return [admitted]
        level, lower = levels[0], levels[1:]
        best: list[list[Need]] = []
        for dropped in range(len(level) + 1):
            for out in combinations(range(len(level)), dropped):
                if self._tried >= MOST_DROPS:
                    self.is_complete = False
                    return best or self.most(self._one_by_one(admitted, level), lower)
                kept = [need for i, need in enumerate(level) if i not in out]
                if kept and not self._fits(admitted + kept):
                    continue
                # Of as many of this level, those that leave the most to lower ones.
                wholes = self.most(admitted + kept, lower)
                new = _counts(wholes[0], lower)
                known = _counts(best[0], lower) if best else []
                if not best or new > known:
                    best = wholes
                elif new == known:
                    best += wholes
            if best:
                return best
        return [admitted]

    def _one_by_one(self, admitted: list[Need], level: list[Need]) -> list[Need]:
        for need in level:
            if self._fits([*admitted, need]):
                admitted = [*admitted, need]
        return admitted

    def _fits(self, kept: list[Need]) -> bool:
        self._tried += 1
        if not self._may_fit(kept):
            return False
        result = _choose(self._problem, kept, self._decide, 0.02)
        self.is_complete &= result.feasible or result.proven
        return result.feasible

    def _may_fit(self, kept: list[Need]) -> bool:
        """Return whether all computers together have enough, which is quick to say."""
        return all(
            fits(
                sum(min(self._total(b, resource) for b in need) for need in kept),
                usable,
            )
            for resource, usable in self._usable.items()
        )

    def _total(self, bundle: Bundle, resource: str) -> float:
        return sum(self._demand[n].get(resource, 0.0) for n in bundle.components)


def _counts(admitted: list[Need], levels: list[list[Need]]) -> list[int]:
    """Return how many of each level are among those admitted."""
    return [sum(need in admitted for need in level) for level in levels]


def _choose(
    problem: Problem, every: list[Need], decide: Decide, share: float
) -> Result:
    """Return the best result over the combinations of alternatives."""
    count = prod(len(need) for need in every)
    complete = count <= MOST_COMBINATIONS
    combos = product(*every) if complete else _one_change_each(every)
    best: Result | None = None
    bound, proven = inf, complete
    for combo in combos:
        result = decide(members(problem, combo), share / min(count, MOST_COMBINATIONS))
        result.choice = _choice(problem, every, combo)
        # What no combination is below, no placement is below.
        if not (result.proven and not result.feasible):
            bound = min(bound, -inf if result.bound is None else result.bound)
        proven = proven and result.proven
        if best is None or _better(result, best):
            best = result
        if result.stopped_by == "interrupted" and best.feasible:
            complete = proven = False
            break
    assert best is not None  # noqa: S101 - there is one combination at least
    if count > 1:
        best.settle(bound if complete else -inf, proven=proven)
    return best


def _one_change_each(every: list[Need]) -> Iterator[Need]:
    first = tuple(need[0] for need in every)
    yield first
    for i, need in enumerate(every):
        for other in need[1:]:
            yield (*first[:i], other, *first[i + 1 :])


def _choice(problem: Problem, every: list[Need], combo: Need) -> Selection:
    lost = sum(
        need[0].quality - chosen.quality
        for need, chosen in zip(every, combo, strict=True)
    )
    picked = {
        chosen.function: chosen.name
        for need, chosen in zip(every, combo, strict=True)
        if len(need) > 1
    }
    return Selection(picked, lost=lost * problem.objective.quality)


def _better(result: Result, best: Result) -> bool:
    if result.feasible != best.feasible:
        return result.feasible
    if result.objective is None or best.objective is None:
        return False
    return result.objective.total < best.objective.total
