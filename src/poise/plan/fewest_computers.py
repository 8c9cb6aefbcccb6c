"""On how few, or how cheap, computers a task still fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

from poise.errors import UsageError
from poise.model.robot import Computer
from poise.plan.conflict import is_hopeless
from poise.plan.phase_problem import TaskProblem
from poise.plan.phase_result import TaskResult
from poise.plan.problem.arrays import arrays_of
from poise.plan.problem.changed_problem import without
from poise.plan.problem.problem import Problem

MOST_SETS = 4096
"""Of how many computers all sets are looked at: with more, one is dropped at a time."""


class Smallest(NamedTuple):
    """The computers on which each problem fits, and whether no cheaper set will do.

    `results` are in the order of the problems; after one that does not fit, none
    follow. `proven` is False where a cheaper set was given up undecided, or not looked
    at.
    """

    computers: tuple[str, ...]
    results: tuple[TaskResult, ...]
    proven: bool

    @property
    def feasible(self) -> bool:
        """Whether all fit."""
        return all(result.feasible for result in self.results)

    @property
    def stopped_by(self) -> str:
        """Why the solver stopped that was the last."""
        return self.results[-1].stopped_by


def smallest(
    problems: Sequence[TaskProblem], decide: Callable[[TaskProblem], TaskResult]
) -> Smallest:
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
        Solves one, such as `solve_phases`.
    """
    computers = problems[0].computers

    def attempt(kept: tuple[str, ...]) -> Smallest | None:
        """Solve with some computers only; None: they clearly cannot do."""
        dropped = {h.name for h in computers} - {*kept}
        try:
            smaller = [
                problem.changed(lambda p: _without(p, dropped)) for problem in problems
            ]
        except UsageError:
            return None
        results: list[TaskResult] = []
        for problem in smaller:
            results.append(decide(problem))
            if not results[-1].feasible:
                break
        return Smallest(kept, tuple(results), results[-1].proven)

    if 2 ** len(computers) <= MOST_SETS:
        return _cheapest_first(computers, attempt)
    return _drop_one_by_one(computers, attempt)


Try = Callable[[tuple[str, ...]], Smallest | None]


def _cheapest_first(computers: tuple[Computer, ...], attempt: Try) -> Smallest:
    proven = True
    every = tuple(h.name for h in computers)
    for kept in _by_price(computers):
        result = attempt(kept)
        if result is None:
            continue
        if result.feasible or kept == every:
            return result._replace(proven=proven)
        if result.stopped_by == "interrupted":
            proven = False  # the sets that follow were not looked at
            break
        proven = proven and result.proven
    whole = attempt(every)
    assert whole is not None  # noqa: S101 - of all computers none was dropped
    return whole._replace(proven=proven)


def _by_price(computers: tuple[Computer, ...]) -> Iterator[tuple[str, ...]]:
    price = {h.name: h.price for h in computers}
    sets = [
        kept for size in range(1, len(price) + 1) for kept in combinations(price, size)
    ]
    yield from sorted(sets, key=lambda kept: (sum(price[h] for h in kept), len(kept)))


def _without(problem: Problem, dropped: set[str]) -> Problem:
    """Return the problem without some computers; UsageError: it clearly cannot do."""
    if not dropped:
        return problem
    smaller = without(problem, dropped)
    # Of architectures, not all may have to be placed.
    if not smaller.architectures and is_hopeless(arrays_of(smaller)):
        raise UsageError("the remaining computers have too little")
    return smaller


def _drop_one_by_one(computers: tuple[Computer, ...], attempt: Try) -> Smallest:
    best = attempt(tuple(h.name for h in computers))
    assert best is not None  # noqa: S101 - of all computers none was dropped
    for computer in sorted(computers, key=lambda h: -h.price):
        kept = best.computers
        if len(kept) == 1 or not best.feasible or best.stopped_by == "interrupted":
            break
        smaller = attempt(tuple(name for name in kept if name != computer.name))
        if smaller is not None and smaller.feasible:
            best = smaller
    return best._replace(proven=False)
