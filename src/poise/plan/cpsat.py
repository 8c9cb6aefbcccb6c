"""The placement by OR-Tools CP-SAT: an independent certificate (extra `exact`).

Real numbers become whole ones: demands and limits in parts of 10^12 of the largest
limit, so that rounding is less than the slack that limits have; F in millionths of its
own scale. What it proves is therefore proven to about a millionth.
"""

from __future__ import annotations

from collections.abc import Sequence
from threading import Thread
from typing import Any

from poise.errors import UsageError
from poise.plan.engine import Answer, Ask
from poise.plan.problem import SLACK
from poise.plan.tables import Placed, Tables

# OR-Tools may not be installed where this is checked.
CpModel = Any
CpSolver = Any
IntVar = Any
LinearExprT = Any

UNITS = 1_000_000
"""In how many parts the scale of F is divided."""
MOST_VARIABLES = 200_000
"""With more, setting up the program takes longer than solving it here."""
PARTS = 10**12
"""In how many parts a limit is divided."""
LOOK = 0.02
"""How long it may take to notice that it should stop [s]."""


def solve(
    tables: Tables,
    seconds: float,
    seed: int,
    *,
    known: Sequence[int] = (),
    workers: int = 2,
    stop: Ask | None = None,
) -> Answer:
    """Return the best placement that CP-SAT finds, and its bound.

    Parameters
    ----------
    known
        A placement to start from; empty: none.
    workers
        How many threads it may use.
    stop
        Asked 50 times a second whether to stop now.

    Raises
    ------
    UsageError
        When OR-Tools is not installed, or the problem is too large.
    """
    each = tables.m * (tables.m if tables.distance else 1)
    variables = tables.n * tables.m + len(tables.first) * each
    if variables > MOST_VARIABLES:
        raise UsageError(
            f"{tables.n} components with {len(tables.first)} connectors on {tables.m} "
            "computers are too many for 'cpsat'; take 'search'"
        )
    if stop is not None and stop():
        return Answer([*known], float("-inf"), False, "interrupted", 0)
    try:
        from ortools.sat.python import cp_model  # noqa: PLC0415 - an extra, and slow
    except ImportError as error:
        raise UsageError("cpsat needs OR-Tools: pip install 'poise[exact]'") from error
    model = _Model(cp_model.CpModel(), tables)
    model.hint(known)
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = max(seconds, 1e-3)
    solver.parameters.random_seed = seed & 0x7FFFFFFF
    solver.parameters.num_workers = workers
    status, interrupted = _run(solver, model.model, stop)
    bound = float("-inf")
    placed: Placed = []
    if status in {"OPTIMAL", "FEASIBLE"}:
        placed = [
            next(h for h in range(tables.m) if solver.boolean_value(row[h]))
            for row in model.on
        ]
        # What rounding may have added to F: half a unit for every term.
        bound = (solver.best_objective_bound - model.terms) / model.scale
    if status in {"OPTIMAL", "INFEASIBLE"}:
        return Answer(placed, bound, True, "proven" if placed else "infeasible", 0)
    return Answer(placed, bound, False, "interrupted" if interrupted else "budget", 0)


def _run(solver: CpSolver, model: CpModel, stop: Ask | None) -> tuple[str, bool]:
    """Let the solver run; its status, and whether Ctrl-C or `stop` ended it.

    It runs in a thread of its own, as only from beside it can it be stopped. Its own
    way with Ctrl-C is switched off: it leaves the process without Python's.
    """
    solver.parameters.catch_sigint_signal = False
    ended: list[str] = []
    thread = Thread(target=lambda: ended.append(solver.solve(model).name), daemon=True)
    thread.start()
    interrupted = False
    while thread.is_alive():
        try:
            thread.join(LOOK)
            interrupted = interrupted or (stop is not None and stop())
        except KeyboardInterrupt:
            interrupted = True
        if interrupted:
            solver.stop_search()
    return ended[0] if ended else "failed", interrupted


class _Model:
    """The 0-1 program: `on[unit][computer]`, limits, and F in whole numbers."""

    def __init__(self, model: CpModel, tables: Tables) -> None:
        self.model = model
        self.tables = tables
        self.terms = 0
        self.on = [
            [model.new_bool_var(f"u{u}h{h}") for h in range(tables.m)]
            for u in range(tables.n)
        ]
        self.scale = UNITS / max(1e-12, self._largest())
        self._limits()
        objective: list[LinearExprT] = []
        objective += self._connectors()
        objective += self._costs()
        objective += self._spreads()
        model.minimize(sum(objective))

    def hint(self, known: Sequence[int]) -> None:
        """Let the search begin at a placement."""
        for row, computer in zip(self.on, known, strict=False):
            for h, here in enumerate(row):
                self.model.add_hint(here, h == computer)

    def _largest(self) -> float:
        """Return about how large F may be."""
        t = self.tables
        far = max(t.distance, default=1.0)
        costs = [abs(c) for c in t.cost]
        spreads = (self._widest(k) * weight for k, weight in enumerate(t.spread))
        return (
            t.communication * sum(t.overhead) * far
            + sum(spreads)
            + t.n * max(costs, default=0.0)
        ) or 1.0

    def _widest(self, k: int) -> float:
        """Return about how large the spread of a resource may be."""
        top = self._top(k)
        return top * top if self.tables.variance else top

    def _top(self, k: int) -> float:
        """Return the largest residue of a resource."""
        t = self.tables
        return 1.0 if t.share else max(t.capacity[k :: t.r], default=0.0)

    def _whole(self, value: float) -> int:
        self.terms += 1
        return round(value * self.scale)

    def _limits(self) -> None:
        t = self.tables
        for row in self.on:
            self.model.add_exactly_one(row)
        for u, computers in t.allowed.items():
            for h in range(t.m):
                if h not in computers:
                    self.model.add(self.on[u][h] == 0)
        for i, j in t.apart:
            for h in range(t.m):
                self.model.add(self.on[i][h] + self.on[j][h] <= 1)
        for k in range(t.r):
            demands = t.demand[k :: t.r]
            for h in range(t.m):
                used = [self.on[u][h] for u in range(t.n)]
                self._hold(demands, used, t.limit[h * t.r + k])
        if t.bandwidth:
            self._links()

    def _hold(
        self, amounts: Sequence[float], used: Sequence[LinearExprT], limit: float
    ) -> None:
        """Keep the sum of what is used, rounded down, to a limit with its slack."""
        part = (limit + SLACK * max(1.0, limit)) / PARTS
        # More than the whole limit is too much, however much it is.
        whole = [int(min(amount / part, 2.0 * PARTS)) for amount in amounts]
        pairs = zip(whole, used, strict=True)
        self.model.add(sum(w * x for w, x in pairs if w) <= PARTS)

    def _links(self) -> None:
        t = self.tables
        pairs = [
            row for row in zip(t.first, t.second, t.traffic, strict=True) if row[2] > 0
        ]
        for a in range(t.m):
            for b in range(a):
                limit = t.bandwidth[a * t.m + b]
                if limit < float("inf"):
                    apart = [self._both(i, a, j, b) for i, j, _ in pairs]
                    self._hold([w for *_, w in pairs], apart, limit)

    def _both(self, i: int, a: int, j: int, b: int) -> LinearExprT:
        """Return 1 when units i and j are on computers a and b, either way round."""
        total: LinearExprT = 0
        for x, y in ((a, b), (b, a)):
            both = self.model.new_bool_var("")
            self.model.add_bool_or([self.on[i][x].Not(), self.on[j][y].Not(), both])
            self.model.add_implication(both, self.on[i][x])
            self.model.add_implication(both, self.on[j][y])
            total = total + both
        return total

    def _connectors(self) -> list[LinearExprT]:
        t = self.tables
        out: list[LinearExprT] = []
        for i, j, overhead in zip(t.first, t.second, t.overhead, strict=True):
            cost = t.communication * overhead
            if cost <= 0:
                continue
            if t.distance:
                out += [
                    self._whole(cost * t.distance[a * t.m + b]) * self._both(i, a, j, b)
                    for a in range(t.m)
                    for b in range(a)
                ]
                continue
            apart = self.model.new_bool_var("")
            for h in range(t.m):
                self.model.add_implication(
                    self.on[i][h], self.on[j][h]
                ).only_enforce_if(apart.Not())
            out.append(self._whole(cost) * apart)
        return out

    def _costs(self) -> list[LinearExprT]:
        t = self.tables
        return [
            self._whole(t.cost[u * t.m + h]) * self.on[u][h]
            for u in range(t.n)
            for h in range(t.m)
            if t.cost
        ]

    def _spreads(self) -> list[LinearExprT]:
        out: list[LinearExprT] = []
        for k, weight in enumerate(self.tables.spread):
            if weight > 0:
                out += self._spread(k, weight)
        return out

    def _spread(self, k: int, weight: float) -> list[LinearExprT]:
        """Return weight x spread, of residues in parts of the largest."""
        t = self.tables
        residues = [self._residue(k, h) for h in range(t.m) if self._counts(k, h)]
        worth = weight * self._widest(k) * self.scale
        self.terms += t.n + 2
        if len(residues) < 2 or worth < 1:  # noqa: PLR2004 - a spread needs two
            return []
        if t.variance:
            return [self._variance(residues, worth)]
        high = self.model.new_int_var(-UNITS, 2 * UNITS, "")
        low = self.model.new_int_var(-UNITS, 2 * UNITS, "")
        for residue in residues:
            self.model.add(high >= residue)
            self.model.add(low <= residue)
        # Weights are fractions: carry them in a variable of their own.
        out = self.model.new_int_var(0, round(3 * worth) + 1, "")
        self.model.add(UNITS * out >= round(worth) * (high - low))
        return [out]

    def _counts(self, k: int, h: int) -> bool:
        t = self.tables
        return not t.share or t.capacity[h * t.r + k] > 0

    def _residue(self, k: int, h: int) -> LinearExprT:
        t = self.tables
        capacity = t.capacity[h * t.r + k]
        part = (capacity if t.share else self._top(k)) / UNITS or 1.0
        # What asks for more than there is will not be here.
        used = sum(
            round(min(d, 2 * capacity) / part) * self.on[u][h]
            for u, d in enumerate(t.demand[k :: t.r])
        )
        return round(capacity / part) - used

    def _variance(self, residues: list[Any], worth: float) -> LinearExprT:
        """Return the variance, by squares of coarser residues."""
        count = len(residues)
        grid, step = 10_000, UNITS // 10_000
        end = 2 * grid
        shares: list[IntVar] = []
        for residue in residues:
            share = self.model.new_int_var(-end, end, "")
            self.model.add(step * share <= residue)
            self.model.add(step * share > residue - step)
            shares.append(share)
        total = sum(shares)
        squares = []
        for share in shares:
            off = self.model.new_int_var(-count * 2 * end, count * 2 * end, "")
            self.model.add(off == count * share - total)
            square = self.model.new_int_var(0, (count * 2 * end) ** 2, "")
            self.model.add_multiplication_equality(square, [off, off])
            squares.append(square)
        # Worth x sum(off^2) / count^3 / grid^2 is in units of F.
        per_unit = round(count**3 * grid**2 / worth)
        most = count * (count * 2 * end) ** 2
        out = self.model.new_int_var(0, most // max(1, per_unit) + 1, "")
        self.terms += round(worth * 4 / grid) + 1
        self.model.add(max(1, per_unit) * out >= sum(squares) - per_unit)
        return out
