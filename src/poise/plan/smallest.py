"""On how few, or how cheap, computers a task still fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

from poise.errors import UsageError
from poise.plan.change import without
from poise.plan.problem import Problem
from poise.plan.result import Result
from poise.plan.tables import fits, tabulate

MOST_SETS = 4096
"""Of how many computers all sets are looked at: with more, one is dropped at a time."""

Decide = Callable[[Problem], Result]


def smallest(problem: Problem, decide: Decide) -> tuple[tuple[str, ...], Result]:
    """Return the cheapest set of computers on which everything fits, and how.

    The price of a set is the sum of its computers' prices; with all prices 1, the
    fewest computers. With more than 12 computers, computers are dropped one at a time,
    dearest first, as long as everything fits: a good answer, not always the best.

    Parameters
    ----------
    decide
        Solves a problem, such as ``lambda problem: solve(problem, 0.05)``.
    """
    names = [h.name for h in problem.computers]
    if 2 ** len(names) <= MOST_SETS:
        for kept in _by_price(problem):
            result = _try(problem, kept, decide)
            if result is not None and result.feasible:
                return kept, result
        return tuple(names), decide(problem)
    return _drop_one_by_one(problem, decide)


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
    tables = tabulate(smaller)
    for k in range(tables.r):
        if not fits(
            sum(tables.demand[k :: tables.r]), sum(tables.limit[k :: tables.r])
        ):
            return None
    return decide(smaller)


def _drop_one_by_one(
    problem: Problem, decide: Decide
) -> tuple[tuple[str, ...], Result]:
    kept = tuple(h.name for h in problem.computers)
    best = decide(problem)
    dearest = sorted(problem.computers, key=lambda h: -h.price)
    for computer in dearest:
        if len(kept) == 1 or not best.feasible:
            break
        fewer = tuple(name for name in kept if name != computer.name)
        result = _try(problem, fewer, decide)
        if result is not None and result.feasible:
            kept, best = fewer, result
    return kept, best
