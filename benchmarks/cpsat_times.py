"""Time limits in the model of CP-SAT (benchmarks/cpsat.py): never above what is true.

Runs and hops take what they take on computers that nobody else uses. Where runs share
them, a placement that takes longer than that is cut off once it is found, or its F made
right: with all units held that keep its runs waiting, no placement takes less.

It imports internal modules: what it proves is compared with what the core finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import floor
from typing import Any, NamedTuple

from poise.model.hardware import SLACK, fits
from poise.plan.problem.arrays import Arrays, LimitArray, Placed, Times
from poise.plan.summed_times import longest, seconds
from poise.plan.violations import loads

PARTS = 1_000_000
"""In how many parts a limit is divided."""
LEAST_ROOM = 1e-15
"""A limit that leaves less than this is used up [s]."""
LARGEST = 20_000_000
"""What a term of F is at most, in whole parts."""


class Part(NamedTuple):
    """What something takes [s] where a 0-1 expression is 1."""

    takes: float
    used: Any


class TimeModel:
    """The time limits of a model.

    Parameters
    ----------
    program, on
        The program, and its variables ``on[unit][computer]``.
    both
        Returns an expression that is 1 when units i and j are on computers a and b,
        either way round: ``both(i, a, j, b)``.
    scale
        How many whole parts F is counted in.

    Attributes
    ----------
    terms
        What F grows by, for each limit with a price.
    roundings
        How many numbers of these were rounded down.
    """

    def __init__(
        self,
        arrays: Arrays,
        program: Any,  # noqa: ANN401 - OR-Tools has no types
        on: Sequence[Sequence[Any]],
        both: Callable[[int, int, int, int], Any],
        scale: float,
    ) -> None:
        self._arrays = arrays
        self._program = program
        self._on = on
        self._both = both
        self._scale = scale
        self._costs: dict[int, Any] = {}
        self._cuts: set[tuple[int, tuple[tuple[int, int], ...]]] = set()
        self.roundings = 0
        times = arrays.times
        if times is None:
            return
        for i, each in enumerate(times.limits):
            parts = [*self._runs(times, each), *self._hops(times, each)]
            if each[1] > 0:
                self._costs[i] = self._cost(each, parts)
            else:
                self._hold(each, parts)

    @property
    def terms(self) -> Iterator[Any]:
        """What F grows by, for each limit with a price."""
        return iter(self._costs.values())

    def refine(self, placed: Placed) -> bool:
        """Cut off a placement that takes too long, or make its F right; else False."""
        t = self._arrays
        takes = seconds(t, placed, loads(t, placed))
        cuts = [self._cut(i, time, placed) for i, time in enumerate(takes)]
        return any(cuts)

    def _cut(self, i: int, takes: float, placed: Placed) -> bool:
        limit, price, _, cpu, *_ = self._limit(i)
        if (price > 0 and (cpu < 0 or takes <= limit)) or fits(takes, limit):
            return False
        key = i, tuple((u, placed[u]) for u in self._waited_for(i, placed))
        if key in self._cuts:
            return False
        self._cuts.add(key)
        held = [self._on[u][h] for u, h in key[1]]
        if price > 0:
            least = floor(price * (takes / limit - 1) * self._scale)
            self._program.add(self._costs[i] >= least).only_enforce_if(held)
        else:
            self._program.add(sum(held) <= len(held) - 1)
        return True

    def _waited_for(self, i: int, placed: Placed) -> list[int]:
        """Return the units with a part in a limit, and those beside its runs."""
        t = self._arrays
        _, _, _, cpu, runs, hops = self._limit(i)
        ends = [c for c, _ in runs] + [c for hop in hops for c in hop[:2]]
        units = {t.unit_of[c] for c in ends}
        if cpu >= 0:
            busy = {placed[t.unit_of[c]] for c, _ in runs}
            units |= {
                u
                for u, h in enumerate(placed)
                if h in busy and t.demand[u * t.r + cpu] > 0
            }
        return sorted(units)

    def _limit(self, i: int) -> LimitArray:
        assert self._arrays.times is not None
        return self._arrays.times.limits[i]

    def _runs(self, times: Times, limit: LimitArray) -> Iterator[Part]:
        for component, needs in limit[4]:
            here = self._on[self._arrays.unit_of[component]]
            yield from (
                Part(needs / v, x) for v, x in zip(times.speed, here, strict=True)
            )

    def _hops(self, times: Times, limit: LimitArray) -> Iterator[Part]:
        t = self._arrays
        for *ends, needs, crossings, size in limit[5]:
            i, j = (t.unit_of[c] for c in ends)
            for a in range(t.m if i != j else 0):
                for b in range(a):
                    link = a * t.m + b
                    takes = needs
                    takes += crossings * times.latency[link] if times.latency else 0.0
                    takes += size * times.per_byte[link] if times.per_byte else 0.0
                    yield Part(takes, self._both(i, a, j, b))

    def _hold(self, limit: LimitArray, parts: Sequence[Part]) -> None:
        """Keep a limit with its slack, all that counts for it rounded down."""
        room = limit[0] + SLACK * max(1.0, limit[0]) - limit[2]
        if room < 0:
            self._program.add_bool_or([])
        part = max(room, LEAST_ROOM) / PARTS
        # More than the whole limit is too much, however much it is.
        whole = [floor(min(p.takes / part, PARTS + 1)) for p in parts]
        pairs = zip(whole, parts, strict=True)
        self._program.add(sum(w * p.used for w, p in pairs if w) <= PARTS)

    def _cost(self, limit: LimitArray, parts: Sequence[Part]) -> Any:  # noqa: ANN401
        """Return what F grows by at least beyond a limit, in whole parts."""
        most, price, fixed, *_ = limit
        cost = self._program.new_int_var(0, LARGEST, "")
        whole = floor(price * (fixed / most - 1) * self._scale)
        for part in parts:
            whole = whole + floor(price * part.takes / most * self._scale) * part.used
        self._program.add(cost >= whole)
        # Of the parts of a run or hop one counts; and one for what a cut rounds.
        self.roundings += 2 + len(limit[4]) + len(limit[5])
        return cost


def largest(arrays: Arrays) -> float:
    """Return what F grows by at most beyond time limits."""
    limits = arrays.problem.time_limits
    return sum(t.price * longest(arrays.problem, t) / t.limit for t in limits)
