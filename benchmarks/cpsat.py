"""The placement by OR-Tools CP-SAT: a certificate for tests and benchmarks.

CP-SAT counts in whole numbers, and errs when they are large: none here is above 10^7.
So its model is a *relaxation*: demands, and what adds to F, are rounded down, and the
square of the variance is replaced by tangents below it (for time limits see
`benchmarks.cpsat_times`). Every placement that keeps the limits is one of the model,
whose F is no lower there: what CP-SAT proves of the model, a bound or that there is no
placement, holds. What it finds is looked at in real numbers. If it breaks a limit that
rounding hid, or its F is more than the model says, the model gets a cut or a tangent
there, and is solved again. A placement is proven when its F is above the bound by no
more than what rounding alone may hide.

It imports internal modules: what it proves is compared with what the core finds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import floor, inf
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from ortools.sat.python import cp_model

from benchmarks.cpsat_times import TimeModel, largest
from poise.model.hardware import SLACK, fits
from poise.plan import _core
from poise.plan.problem.arrays import Arrays, Placed, arrays_of
from poise.plan.problem.problem import Problem
from poise.plan.violations import loads, traffic

# OR-Tools has no types.
IntVar = Any
LinearExprT = Any

UNITS = 10_000_000
"""In how many parts the scale of F is divided."""
PARTS = 1_000_000
"""In how many parts a limit is divided."""
WORKERS = 2
"""How many threads it may use."""


class Certificate(NamedTuple):
    """The best placement that is known, its F, and a bound of it."""

    placed: Placed
    objective: float
    bound: float
    proven: bool
    stopped_by: str


def certificate(problem: Problem, seconds: float) -> Certificate:
    """Return the best placement of a problem that CP-SAT finds, and its bound."""
    arrays = arrays_of(problem)
    return solve(_core.Core(arrays), arrays, seconds)


def solve(
    core: _core.Core, arrays: Arrays, seconds: float, known: Placed | None = None
) -> Certificate:
    """Return the best placement that CP-SAT finds, and its bound.

    Parameters
    ----------
    known
        A placement to start from; empty: none.
    """
    known = known or []
    best = Certificate(known, _total(core, known), -inf, False, "budget")
    model = _Relaxation(arrays)
    end = perf_counter() + seconds
    while True:
        model.hint(best.placed)
        answer = _run(model, max(end - perf_counter(), 1e-3))
        if answer.status == "INFEASIBLE" and not best.placed:
            return Certificate([], inf, -inf, True, "infeasible")
        if answer.placed and core.feasible(answer.placed):
            total = _total(core, answer.placed)
            if total < best.objective:
                best = best._replace(placed=answer.placed, objective=total)
        best = best._replace(bound=max(best.bound, answer.bound))
        if best.placed and best.objective - best.bound <= model.error:
            return best._replace(proven=True, stopped_by="proven")
        is_over = perf_counter() >= end or answer.status != "OPTIMAL"
        if is_over or not model.refine(answer.placed):
            return best


def _total(core: _core.Core, placed: Placed) -> float:
    return sum(core.terms(placed)) if placed else inf


class _Solved(NamedTuple):
    status: str
    placed: Placed
    bound: float


def _run(model: _Relaxation, seconds: float) -> _Solved:
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = seconds
    solver.parameters.num_workers = WORKERS
    status = solver.solve(model.program).name
    if status not in {"OPTIMAL", "FEASIBLE"}:
        return _Solved(status, [], -inf)
    placed = [
        next(h for h, here in enumerate(row) if solver.boolean_value(here))
        for row in model.on
    ]
    return _Solved(status, placed, solver.best_objective_bound / model.scale)


class _Affine(NamedTuple):
    """A constant, and what each unit adds on each computer, (n, m)."""

    constant: float
    slopes: NDArray[np.float64]


class _Relaxation:
    """The 0-1 program: `on[unit][computer]`, limits, and F in whole numbers.

    `error` is how far its F may be below that of a placement, by rounding alone.
    """

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        self.program = cp_model.CpModel()
        self.on = [
            [self.program.new_bool_var(f"u{u}h{h}") for h in range(arrays.m)]
            for u in range(arrays.n)
        ]
        self.scale = UNITS / max(1e-12, self._largest())
        self._roundings = 0
        self._limits()
        self._squares: list[tuple[IntVar, _Affine]] = []
        self._tangents: set[tuple[int, int]] = set()
        self._times = TimeModel(arrays, self.program, self.on, self._both, self.scale)
        terms = [
            *self._connectors(),
            *self._costs(),
            *self._spreads(),
            *self._shortages(),
            *self._times.terms,
        ]
        self.program.minimize(sum(terms))
        self.error = (self._roundings + self._times.roundings + 1) / self.scale

    def hint(self, known: Sequence[int]) -> None:
        """Let the search begin at a placement."""
        self.program.clear_hints()
        for row, computer in zip(self.on, known, strict=False):
            for h, here in enumerate(row):
                self.program.add_hint(here, h == computer)

    def refine(self, placed: Placed) -> bool:
        """Cut off a placement that breaks a limit, or make its F right; else False."""
        cuts = list(self._broken(placed))
        for units in cuts:
            held = [self.on[u][placed[u]] for u in units]
            self.program.add(sum(held) <= len(held) - 1)
        tangents = [self._tangent(i, placed) for i in range(len(self._squares))]
        is_late = self._times.refine(placed)
        return bool(cuts) or any(tangents) or is_late

    def _largest(self) -> float:
        """Return about how large F may be."""
        t = self.arrays
        far = max(t.distance, default=1.0)
        tops = [
            1.0 if t.share else max(t.capacity[k :: t.r], default=0.0)
            for k in range(t.r)
        ]
        spreads = (
            w * (top * top if t.variance else top)
            for w, top in zip(t.spread, tops, strict=True)
        )
        costs = t.n * max((abs(c) for c in t.cost), default=0.0)
        overhead = sum(o for _, _, o, _ in t.connectors)
        short = sum(price * sum(t.demand[k :: t.r]) for k, price in enumerate(t.price))
        others = costs + short + largest(t)
        return t.communication * overhead * far + sum(spreads) + others or 1.0

    def _whole(self, value: float) -> int:
        """Return a part of F in whole numbers, rounded down."""
        self._roundings += 1
        return floor(value * self.scale)

    def _limits(self) -> None:
        t = self.arrays
        for row in self.on:
            self.program.add_exactly_one(row)
        for u, computers in t.allowed.items():
            for h in range(t.m):
                if h not in computers:
                    self.program.add(self.on[u][h] == 0)
        for i, j in t.apart:
            for h in range(t.m):
                self.program.add(self.on[i][h] + self.on[j][h] <= 1)
        for k in range(t.r):
            self._hold_resource(k)
        if t.bandwidth:
            self._links()

    def _hold_resource(self, k: int) -> None:
        t = self.arrays
        for h in range(t.m if not t.price[k] else 0):
            if t.limit[h * t.r + k] < inf:
                column = [row[h] for row in self.on]
                self._hold(t.demand[k :: t.r], column, t.limit[h * t.r + k])

    def _hold(
        self, amounts: Sequence[float], used: Sequence[LinearExprT], limit: float
    ) -> None:
        """Keep the sum of what is used, rounded down, to a limit with its slack."""
        part = (limit + SLACK * max(1.0, limit)) / PARTS
        # More than the whole limit is too much, however much it is.
        whole = [floor(min(amount / part, PARTS + 1)) for amount in amounts]
        pairs = zip(whole, used, strict=True)
        self.program.add(sum(w * x for w, x in pairs if w) <= PARTS)

    def _links(self) -> None:
        t = self.arrays
        sending = [(i, j, w) for i, j, _, w in t.connectors if w > 0]
        for a in range(t.m):
            for b in range(a):
                limit = t.bandwidth[a * t.m + b]
                if limit < inf:
                    apart = [self._both(i, a, j, b) for i, j, _ in sending]
                    self._hold([w for *_, w in sending], apart, limit)

    def _both(self, i: int, a: int, j: int, b: int) -> LinearExprT:
        """Return 1 when units i and j are on computers a and b, either way round."""
        total: LinearExprT = 0
        for x, y in ((a, b), (b, a)):
            both = self.program.new_bool_var("")
            self.program.add_bool_or([self.on[i][x].Not(), self.on[j][y].Not(), both])
            self.program.add_implication(both, self.on[i][x])
            self.program.add_implication(both, self.on[j][y])
            total = total + both
        return total

    def _broken(self, placed: Placed) -> Iterator[list[int]]:
        """Yield sets of units of which one must be elsewhere, by limits that broke."""
        t = self.arrays
        load = loads(t, placed)
        for h in range(t.m):
            for k in range(t.r):
                if t.price[k]:
                    continue
                if not fits(load[h * t.r + k], t.limit[h * t.r + k]):
                    yield [
                        u
                        for u in range(t.n)
                        if placed[u] == h and t.demand[u * t.r + k] > 0
                    ]
        for (a, b), used in traffic(t, placed).items() if t.bandwidth else ():
            if not fits(used, t.bandwidth[a * t.m + b]):
                yield sorted(
                    {
                        u
                        for i, j, _, w in t.connectors
                        if w > 0 and {placed[i], placed[j]} == {a, b}
                        for u in (i, j)
                    }
                )

    def _connectors(self) -> Iterator[LinearExprT]:
        t = self.arrays
        for i, j, overhead, _ in t.connectors:
            cost = t.communication * overhead
            if cost <= 0:
                continue
            if t.distance:
                for a in range(t.m):
                    for b in range(a):
                        far = self._whole(cost * t.distance[a * t.m + b])
                        yield far * self._both(i, a, j, b)
                continue
            apart = self.program.new_bool_var("")
            for h in range(t.m):
                self.program.add_implication(
                    self.on[i][h], self.on[j][h]
                ).only_enforce_if(apart.Not())
            yield self._whole(cost) * apart

    def _costs(self) -> Iterator[LinearExprT]:
        t = self.arrays
        for u in range(t.n if t.cost else 0):
            for h in range(t.m):
                yield self._whole(t.cost[u * t.m + h]) * self.on[u][h]

    def _spreads(self) -> Iterator[LinearExprT]:
        t = self.arrays
        for k, weight in enumerate(t.spread):
            counted = [
                h for h in range(t.m) if not t.share or t.capacity[h * t.r + k] > 0
            ]
            if weight <= 0 or len(counted) < 2:
                continue
            residues = [self._residue(k, h) for h in counted]
            # Of a range, two residues are rounded; of a variance, every square.
            self._roundings += (t.n + 1) * (len(counted) if t.variance else 2)
            if t.variance:
                yield from self._variance(residues, weight)
            else:
                high = self.program.new_int_var(-2 * UNITS, 2 * UNITS, "")
                low = self.program.new_int_var(-2 * UNITS, 2 * UNITS, "")
                for residue in residues:
                    self.program.add(high >= self._below(residue, weight))
                    self.program.add(low <= -self._below(residue, -weight))
                yield high - low

    def _shortages(self) -> Iterator[LinearExprT]:
        t = self.arrays
        for k, price in enumerate(t.price):
            for h in range(t.m if price else 0):
                slopes = np.zeros((t.n, t.m))
                slopes[:, h] = t.demand[k :: t.r]
                beyond = _Affine(-t.limit[h * t.r + k], slopes)
                short = self.program.new_int_var(0, 2 * UNITS, "")
                self.program.add(short >= self._below(beyond, price))
                self._roundings += t.n + 1
                yield short

    def _residue(self, k: int, h: int) -> _Affine:
        """Return the residue of a resource as what F measures it in."""
        t = self.arrays
        capacity = t.capacity[h * t.r + k]
        unit = capacity if t.share else 1.0
        slopes = np.zeros((t.n, t.m))
        # What asks for more than there is will not be here.
        slopes[:, h] = -np.minimum(t.demand[k :: t.r], 2 * capacity) / unit
        return _Affine(capacity / unit, slopes)

    def _below(self, line: _Affine, factor: float) -> LinearExprT:
        """Return factor x line in whole parts of F, rounded down."""
        whole: LinearExprT = floor(factor * line.constant * self.scale)
        for u, h in zip(*np.nonzero(line.slopes), strict=True):
            slope = factor * line.slopes[u, h]
            whole = whole + floor(slope * self.scale) * self.on[u][h]
        return whole

    def _variance(self, residues: list[_Affine], weight: float) -> Iterator[IntVar]:
        """Yield a variable for each square of a residue less their mean, weighed."""
        count = len(residues)
        factor = (weight / count) ** 0.5
        mean = sum(r.constant for r in residues) / count
        mean_slopes = np.mean([r.slopes for r in residues], axis=0)
        for residue in residues:
            off = _Affine(
                factor * (residue.constant - mean),
                factor * (residue.slopes - mean_slopes),
            )
            square = self.program.new_int_var(0, 4 * UNITS, "")
            self._squares.append((square, off))
            yield square

    def _tangent(self, i: int, placed: Placed) -> bool:
        """Keep a square above its tangent at `placed`; False when it was already."""
        square, off = self._squares[i]
        at = off.constant + sum(off.slopes[u, h] for u, h in enumerate(placed))
        key = i, round(at * self.scale)
        if key in self._tangents:
            return False
        self._tangents.add(key)
        # at^2 + 2 at (off - at) = 2 at off - at^2
        line = _Affine(off.constant - at / 2, off.slopes)
        self.program.add(square >= self._below(line, 2 * at))
        return True
