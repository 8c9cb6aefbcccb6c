"""On how few, or how cheap, computers a task still fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Generic, NamedTuple, TypeVar, cast

from msgspec.structs import replace

from poise.errors import UsageError
from poise.model.robot import Computer
from poise.plan.phases.problem import PhasedProblem
from poise.plan.phases.result import PhasedResult
from poise.plan.problem.arrays import arrays_of
from poise.plan.problem.problem import Problem
from poise.plan.result import Result
from poise.plan.what_if.changed_problem import without
from poise.plan.why.conflict import is_short

MOST_SETS = 4096
"""Of how many computers all sets are looked at: with more, one is dropped at a time."""

P = TypeVar("P", Problem, PhasedProblem)
R = TypeVar("R", Result, PhasedResult)


class Smallest(NamedTuple, Generic[R]):
    """The computers on which each problem fits, and whether no cheaper set will do.

    `results` are in the order of the problems; after one that does not fit, none
    follow. `proven` is False where a cheaper set was given up undecided, or not looked
    at.
    """

    computers: tuple[str, ...]
    results: tuple[R, ...]
    proven: bool

    @property
    def feasible(self) -> bool:
        """Whether all fit."""
        return all(result.feasible for result in self.results)

    @property
    def stopped_by(self) -> str:
        """Why the solver stopped that was the last."""
        return self.results[-1].stopped_by


def smallest(problems: Sequence[P], decide: Callable[[P], R]) -> Smallest[R]:
    """Return the cheapest set of computers on which each problem fits, one at a time.

    The price of a set is the sum of its computers' prices; with all prices 1, the
    fewest computers. With more than 12 computers, computers are dropped one at a time,
    dearest first, as long as everything fits: a good answer, not always the best.
    Where nothing fits on all of them, these are returned. A result of `decide` that
    was interrupted ends the search.

    Parameters
    ----------
    problems
        One or more, on the same computers.
    decide
        Solves one, such as ``lambda problem: solve(problem, 0.05)``.
    """
    computers = _computers(problems[0])

    def attempt(kept: tuple[str, ...]) -> Smallest[R] | None:
        """Solve with some computers only; None: they clearly cannot do."""
        smaller = [_on(problem, kept) for problem in problems]
        if any(problem is None for problem in smaller):
            return None
        results: list[R] = []
        for problem in smaller:
            results.append(decide(cast("P", problem)))
            if not results[-1].feasible:
                break
        return Smallest(kept, tuple(results), results[-1].proven)

    if 2 ** len(computers) <= MOST_SETS:
        return _cheapest_first(computers, attempt)
    return _drop_one_by_one(computers, attempt)


def _computers(problem: Problem | PhasedProblem) -> tuple[Computer, ...]:
    if isinstance(problem, PhasedProblem):
        problem = problem.phases[0].problem
    return problem.computers


Try = Callable[[tuple[str, ...]], Smallest[R] | None]


def _cheapest_first(computers: tuple[Computer, ...], attempt: Try[R]) -> Smallest[R]:
    proven = True
    every = tuple(h.name for h in computers)
    for kept in _by_price(computers):
        found = attempt(kept)
        if found is None:
            continue
        if found.feasible or kept == every:
            return found._replace(proven=proven)
        proven = proven and found.proven
        if found.stopped_by == "interrupted":
            break
    whole = attempt(every)
    assert whole is not None  # noqa: S101 - of all computers none was dropped
    return whole._replace(proven=proven)


def _by_price(computers: tuple[Computer, ...]) -> Iterator[tuple[str, ...]]:
    price = {h.name: h.price for h in computers}
    sets = [
        kept for size in range(1, len(price) + 1) for kept in combinations(price, size)
    ]
    yield from sorted(sets, key=lambda kept: (sum(price[h] for h in kept), len(kept)))


def _on(problem: P, kept: tuple[str, ...]) -> P | None:
    """Return the problem on these computers; None when they clearly cannot do."""
    if isinstance(problem, PhasedProblem):
        parts = [(p, _on(p.problem, kept)) for p in problem.phases]
        phases = [replace(p, problem=part) for p, part in parts if part is not None]
        if len(phases) < len(parts):
            return None
        return replace(problem, phases=tuple(phases))
    dropped = [h.name for h in problem.computers if h.name not in kept]
    if not dropped:
        return problem
    try:
        smaller = without(problem, dropped)
    except UsageError:
        return None
    # Of architectures, not all may have to be placed.
    if not smaller.architectures and is_short(arrays_of(smaller)):
        return None
    return smaller


def _drop_one_by_one(computers: tuple[Computer, ...], attempt: Try[R]) -> Smallest[R]:
    best = attempt(tuple(h.name for h in computers))
    assert best is not None  # noqa: S101 - of all computers none was dropped
    for computer in sorted(computers, key=lambda h: -h.price):
        kept = best.computers
        if len(kept) == 1 or not best.feasible or best.stopped_by == "interrupted":
            break
        found = attempt(tuple(name for name in kept if name != computer.name))
        if found is not None and found.feasible:
            best = found
    return best._replace(proven=False)
