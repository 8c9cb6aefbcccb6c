"""The C++ core, fed with `Tables`."""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import NamedTuple, cast

from poise.errors import UsageError
from poise.plan import _core
from poise.plan.result import Stopped
from poise.plan.tables import Placed, Tables

Ask = Callable[[], bool]
"""Tells a solver, which asks 100 times a second, whether to stop now."""

UNLIMITED = 1 << 62
"""A number of steps that no solver reaches."""


class Answer(NamedTuple):
    """What a solver of the core hands back.

    `placed` is empty when no placement was found. `steps` counts search moves tried,
    or nodes opened.
    """

    placed: Placed
    bound: float
    proven: bool
    stopped_by: Stopped
    steps: int


class Engine:
    """A problem compiled into the core: built once, solved many times.

    `greedy()` returns the greedy's placement, with -1 for what it did not reach;
    `provable` says whether the problem is small enough for `exact`.
    """

    def __init__(self, tables: Tables) -> None:
        self.tables = tables
        allowed = tables.allowed
        self.core = _core.Core(
            tables.n,
            tables.m,
            tables.r,
            tables.demand,
            tables.capacity,
            tables.limit,
            tables.size,
            list(allowed),
            [0, *accumulate(len(computers) for computers in allowed.values())],
            [h for computers in allowed.values() for h in computers],
            tables.first,
            tables.second,
            tables.overhead,
            tables.traffic,
            tables.distance,
            tables.cost,
            tables.bandwidth,
            [i for i, _ in tables.apart],
            [j for _, j in tables.apart],
            tables.communication,
            tables.spread,
            tables.share,
            tables.variance,
        )
        self.greedy = self.core.greedy
        self.provable: bool = self.core.provable

    def must_be_provable(self) -> None:
        """Raise a UsageError when the problem is too large for `exact`."""
        if not self.provable:
            raise UsageError(
                f"{self.tables.n} components on {self.tables.m} computers are too many "
                "for 'exact' (at most 1024 on 64); take 'search'"
            )

    def exact(
        self,
        known: Placed,
        seconds: float = 1e9,
        steps: int = UNLIMITED,
        stop: Ask | None = None,
    ) -> Answer:
        """Search for the optimum and its proof, starting from a known placement."""
        return _answer(self.core.exact(known, seconds, steps, stop))

    def search(
        self,
        known: Placed,
        seconds: float = 1e9,
        steps: int = UNLIMITED,
        seed: int = 0,
        stop: Ask | None = None,
    ) -> Answer:
        """Search until time or steps are used up; never worse than `known`."""
        return _answer(self.core.search(known, seconds, steps, seed, stop))

    def total(self, placed: Placed) -> float:
        """Return F of a placement, recomputed from nothing."""
        return sum(self.core.terms(placed))

    def feasible(self, placed: Placed) -> bool:
        """Return whether a complete placement keeps every limit."""
        return self.core.feasible(placed)

    def bound(self) -> float:
        """Return a number that no placement's F is below."""
        return self.core.bound()


def _answer(raw: tuple[list[int], float, bool, str, int]) -> Answer:
    placed, bound, proven, reason, steps = raw
    return Answer(placed, bound, proven, cast("Stopped", reason), steps)
