"""On how few, or how cheap, computers a task still fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations
from typing import NamedTuple

from poise.errors import UsageError
from poise.plan.problem.arrays import arrays_of
from poise.plan.problem.problem import Problem
from poise.plan.result import Result
from poise.plan.what_if.changed_problem import without
from poise.plan.why.conflict import is_short

MOST_SETS = 4096
"""Of how many computers all sets are looked at: with more, one is dropped at a time."""

Decide = Callable[[Problem], Result]


class Smallest(NamedTuple):
    """The computers on which everything fits, how, and whether no cheaper set will do.

    `proven` is False where a cheaper set was given up undecided, or not looked at.
    """

    computers: tuple[str, ...]
    result: Result
    proven: bool


def smallest(problem: Problem, decide: Decide) -> Smallest:
    """Return the cheapest set of computers on which everything fits, and how.

    The price of a set is the sum of its computers' prices; with all prices 1, the
    fewest computers. With more than 12 computers, computers are dropped one at a time,
    dearest first, as long as everything fits: a good answer, not always the best.
    Where nothing fits on all of them, these are returned. A result of `decide` that
    was interrupted ends the search.

    Parameters
    ----------
    decide
        Solves a problem, such as ``lambda problem: solve(problem, 0.05)``.
    """
    if 2 ** len(problem.computers) <= MOST_SETS:
        return _cheapest_first(problem, decide)
    return _drop_one_by_one(problem, decide)


def _cheapest_first(problem: Problem, decide: Decide) -> Smallest:
    proven = True
    for kept in _by_price(problem):
        result = _try(problem, kept, decide)
        if result is None:
            continue
        if result.feasible:
            return Smallest(kept, result, proven)
        proven = proven and result.proven
        if result.stopped_by == "interrupted":
            break
    return Smallest(tuple(h.name for h in problem.computers), decide(problem), proven)


def _by_price(problem: Problem) -> Iterator[tuple[str, ...]]:
    price = {h.name: h.price for h in problem.computers}
    sets = [
        kept for size in range(1, len(price) + 1) for kept in combinations(price, size)
    ]
    yield from sorted(sets, key=lambda kept: (sum(price[h] for h in kept), len(kept)))


def _try(problem: Problem, kept: tuple[str, ...], decide: Decide) -> Result | None:
    """Return the result on these computers; None when they clearly cannot do."""
    dropped = [h.name for h in problem.computers if h.name not in kept]
    try:
        smaller = without(problem, dropped) if dropped else problem
    except UsageError:
        return None
    # Of architectures, not all may have to be placed.
    if not smaller.architectures and is_short(arrays_of(smaller)):
        return None
    return decide(smaller)


def _drop_one_by_one(problem: Problem, decide: Decide) -> Smallest:
    kept = tuple(h.name for h in problem.computers)
    best = decide(problem)
    dearest = sorted(problem.computers, key=lambda h: -h.price)
    for computer in dearest:
        if len(kept) == 1 or not best.feasible or best.stopped_by == "interrupted":
            break
        fewer = tuple(name for name in kept if name != computer.name)
        result = _try(problem, fewer, decide)
        if result is not None and result.feasible:
            kept, best = fewer, result
    return Smallest(kept, best, proven=False)
