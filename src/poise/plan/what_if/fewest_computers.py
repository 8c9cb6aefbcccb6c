"""On how few, or how cheap, computers a task still fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple, Protocol, TypeVar

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

Decide = Callable[[Problem], Result]
DecidePhases = Callable[[PhasedProblem], PhasedResult]


class Smallest(NamedTuple):
    """The computers on which everything fits, how, and whether no cheaper set will do.

    `proven` is False where a cheaper set was given up undecided, or not looked at.
    """

    computers: tuple[str, ...]
    result: Result
    proven: bool


class SmallestForTasks(NamedTuple):
    """The computers on which each of several tasks fits; as `Smallest` otherwise.

    `results` are in the order of the tasks; after one that does not fit, none follow.
    """

    computers: tuple[str, ...]
    results: tuple[PhasedResult, ...]
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
    return Smallest(
        *_cheapest(problem.computers, lambda kept: _try(problem, kept, decide))
    )


def smallest_for_tasks(
    problems: Sequence[PhasedProblem], decide: DecidePhases
) -> SmallestForTasks:
    """Return the cheapest set of computers on which each task fits, one at a time.

    Parameters
    ----------
    problems
        Those of the tasks, one or more, on the same computers.
    decide
        Solves one of them, such as `poise.plan.solve_phases`.
    """
    computers = problems[0].phases[0].problem.computers
    kept, several, proven = _cheapest(
        computers, lambda kept: _try_all(problems, kept, decide)
    )
    return SmallestForTasks(kept, several.results, proven)


class _Answer(Protocol):
    @property
    def feasible(self) -> bool: ...
    @property
    def proven(self) -> bool: ...
    @property
    def stopped_by(self) -> str: ...


A = TypeVar("A", bound=_Answer)
Try = Callable[[tuple[str, ...]], A | None]
"""Solves with some computers only; None: they clearly cannot do. Never None for all."""


class _Several(NamedTuple):
    """The answers for tasks up to the first that does not fit."""

    results: tuple[PhasedResult, ...]

    @property
    def feasible(self) -> bool:
        return all(result.feasible for result in self.results)

    @property
    def proven(self) -> bool:
        return self.results[-1].proven

    @property
    def stopped_by(self) -> str:
        return self.results[-1].stopped_by


def _cheapest(
    computers: tuple[Computer, ...], attempt: Try[A]
) -> tuple[tuple[str, ...], A, bool]:
    if 2 ** len(computers) <= MOST_SETS:
        return _cheapest_first(computers, attempt)
    return _drop_one_by_one(computers, attempt)


def _cheapest_first(
    computers: tuple[Computer, ...], attempt: Try[A]
) -> tuple[tuple[str, ...], A, bool]:
    proven = True
    every = tuple(h.name for h in computers)
    for kept in _by_price(computers):
        answer = attempt(kept)
        if answer is None:
            continue
        if answer.feasible or kept == every:
            return kept, answer, proven
        proven = proven and answer.proven
        if answer.stopped_by == "interrupted":
            break
    whole = attempt(every)
    assert whole is not None  # noqa: S101 - of all computers none was dropped
    return every, whole, proven


def _by_price(computers: tuple[Computer, ...]) -> Iterator[tuple[str, ...]]:
    price = {h.name: h.price for h in computers}
    sets = [
        kept for size in range(1, len(price) + 1) for kept in combinations(price, size)
    ]
    yield from sorted(sets, key=lambda kept: (sum(price[h] for h in kept), len(kept)))


def _on(problem: Problem, kept: tuple[str, ...]) -> Problem | None:
    """Return the problem on these computers; None when they clearly cannot do."""
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


def _try(problem: Problem, kept: tuple[str, ...], decide: Decide) -> Result | None:
    smaller = _on(problem, kept)
    return None if smaller is None else decide(smaller)


def _try_all(
    problems: Sequence[PhasedProblem], kept: tuple[str, ...], decide: DecidePhases
) -> _Several | None:
    smaller = []
    for problem in problems:
        parts = [(p, _on(p.problem, kept)) for p in problem.phases]
        phases = [replace(p, problem=part) for p, part in parts if part is not None]
        if len(phases) < len(parts):
            return None
        smaller.append(replace(problem, phases=tuple(phases)))
    results: list[PhasedResult] = []
    for problem in smaller:
        results.append(decide(problem))
        if not results[-1].feasible:
            break
    return _Several(tuple(results))


def _drop_one_by_one(
    computers: tuple[Computer, ...], attempt: Try[A]
) -> tuple[tuple[str, ...], A, bool]:
    kept = tuple(h.name for h in computers)
    best = attempt(kept)
    assert best is not None  # noqa: S101 - of all computers none was dropped
    for computer in sorted(computers, key=lambda h: -h.price):
        if len(kept) == 1 or not best.feasible or best.stopped_by == "interrupted":
            break
        fewer = tuple(name for name in kept if name != computer.name)
        answer = attempt(fewer)
        if answer is not None and answer.feasible:
            kept, best = fewer, answer
    return kept, best, False
