"""The placements of all phases so far, and the steps that better them.

F of the whole is the mean of the phases' F over time, and what moves cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate, zip_longest
from math import inf
from random import Random
from time import perf_counter

from msgspec.structs import replace

from poise.plan._core import Core
from poise.plan.alternatives import given_up
from poise.plan.phase_problem import TaskProblem, beside, with_moves
from poise.plan.phase_result import TaskResult
from poise.plan.planner import BUDGET, Budget, Effort, Planner
from poise.plan.problem.arrays import Arrays, LimitArray, Placed, Times, arrays_of
from poise.plan.problem.changed_problem import keep_components
from poise.plan.problem.problem import Problem
from poise.plan.result import CompiledProblem, Result
from poise.plan.result_records import Ask, Selection

ALONE = 0.3
"""Which part of the budget goes into placing each phase alone."""
CHAINED = 0.3
"""Which part goes into placing each with those beside it, forwards and backwards."""
TOGETHER = 0.02
"""Which part goes into one search of several phases as one problem."""
MOST_TOGETHER = 3
"""So many phases are placed as one problem; of more, a search finds less."""
ROUNDS = 2
"""So often for each phase, where steps are counted instead of time."""


Solution = Mapping[str, Result]
"""Phase -> its placement, whose F has no moves; one that has none is not there."""


def _of(compiled: CompiledProblem, placed: Placed, choice: Selection) -> Result:
    result = Result.of(compiled, placed, "phases")
    result.choice = choice
    return result


class PhaseSearch:
    """Places phases with regard to those beside them."""

    def __init__(
        self, problem: TaskProblem, method: str, effort: Effort, *, fewer: bool
    ) -> None:
        self._problem = problem
        self._method = method
        self._effort = effort
        self._fewer = fewer
        self._problems = {phase.name: phase.problem for phase in problem.phases}
        self._beside = beside(problem)
        self._weights = problem.weights
        self._lasts = problem.lasts
        # where steps are counted, time is not
        self._budget = Budget(effort.seconds if effort.steps is None else inf)
        self.interrupted = False

    def alone(self) -> dict[str, Result]:
        """Return each phase placed as if there were no other."""
        results: dict[str, Result] = {}
        count = len(self._problems)
        share = ALONE / count if count > 1 else 1.0
        for name, problem in self._problems.items():
            same = next((n for n in results if self._problems[n] == problem), None)
            if same is not None:
                results[name] = results[same]
                continue
            result = self._decide(problem, share)
            is_known = result.feasible or result.proven
            if count > 1 and not (is_known or self.interrupted):
                result = self._decide(problem, 1.0)
            results[name] = result
        return results

    def total(self, held: Solution) -> float:
        """Return F of all phases, and of what moves between them."""
        return self._cost(held, held)

    def chained(self, start: Solution) -> dict[str, Result]:
        """Place one phase after the other beside those before, and then backwards."""
        held: dict[str, Result] = {}
        share = CHAINED / 2 / len(start)
        for name in start:
            held[name] = self._step(name, held, start[name], share)
        for name in reversed(list(start)):
            held[name] = self._step(name, held, held[name], share)
        return held

    def together(self, start: Solution, bound: float) -> dict[str, Result]:
        """Search phases beside each other as one problem, while time is left."""
        held, random = dict(start), Random(self._effort.seed)  # noqa: S311 - no secret
        most = inf if self._effort.steps is None else ROUNDS * len(held)
        rounds = 0
        while (
            rounds < most
            and self._budget.left() > 0
            and not self.interrupted
            and self.total(held) > bound
        ):
            rounds += 1
            names = self._some_beside(list(held), random)
            better = self._search(names, held, rounds)
            if better and self._cost(better, held) < self._cost(
                {name: held[name] for name in names}, held
            ):
                held |= better
        return held

    def _decide(self, problem: Problem, share: float) -> Result:
        """Place one phase with a share of the effort."""
        effort = self._effort.share(share)
        result = Planner(problem).decide(
            self._method,
            effort.seconds,
            effort.seed,
            steps=effort.steps,
            fewer=self._fewer,
            stop=effort.stop,
        )
        self.interrupted |= result.stopped_by == "interrupted"
        return result

    def _step(self, name: str, held: Solution, now: Result, share: float) -> Result:
        """Place one phase beside those that are held; as `now` if that is no worse."""
        if self.interrupted or self._budget.left() <= 0:
            return now
        placements = {phase: h.placement for phase, h in held.items()}
        problem = with_moves(self._problem, name, placements, start=True)
        result = self._decide(problem, share)
        runs_less = given_up(problem, result.suspended) > given_up(
            problem, now.suspended
        )
        if runs_less or not result.placement:  # its F is that of less
            return now
        compiled = CompiledProblem(
            keep_components(self._problems[name], result.placement)
        )
        moved = _of(compiled, compiled.arrays.placed(result.placement), result.choice)
        if name not in held:
            return moved
        cost = self._cost({name: now}, held)
        return moved if self._cost({name: moved}, held) < cost else now

    def _some_beside(self, names: Sequence[str], random: Random) -> list[str]:
        """Return two or three phases of which each is beside another one."""
        chosen = [random.choice(names)]
        for _ in range(random.randint(1, MOST_TOGETHER - 1)):
            near = [
                other
                for name in chosen
                for other in self._beside[name]
                if other in names and other not in chosen
            ]
            if near:
                chosen.append(random.choice(near))
        return chosen

    def _search(
        self, names: Sequence[str], held: Solution, seed: int
    ) -> dict[str, Result]:
        """Search some phases together; empty when a link's bandwidth is not kept."""
        others = {n: h.placement for n, h in held.items() if n not in names}
        parts = []
        for name in names:
            compiled = held[name].compiled
            problem = with_moves(self._problem, name, others)
            part = keep_components(problem, held[name].placement)
            arrays = replace(compiled.arrays, cost=arrays_of(part).cost)
            parts.append(weighted(arrays, self._weights[name]))
        known = [unit for name in names for unit in held[name].placed]
        core = Core(merged(parts, self._between(names, held)))
        effort = self._effort.share(TOGETHER)
        seconds = max(0.0, min(effort.seconds, self._budget.left()))
        answer = effort._replace(seconds=seconds, seed=seed).search(core, known)
        self.interrupted |= answer.stopped_by == "interrupted"
        placed, results = answer.placed, dict[str, Result]()
        for name in names:
            count = len(held[name].placed)
            here, placed = placed[:count], placed[count:]
            if not held[name].compiled.core.feasible(here):
                return {}
            results[name] = _of(held[name].compiled, here, held[name].choice)
        return results

    def _between(
        self, names: Sequence[str], held: Solution
    ) -> dict[tuple[Unit, Unit], float]:
        """Return what it costs that a component is apart in two of these phases."""
        moves: dict[tuple[Unit, Unit], float] = {}
        for p, one in enumerate(names):
            for q, two in enumerate(names[:p]):
                often = self._beside[one].get(two)
                if often is None:
                    continue
                here, there = (held[n].compiled.arrays for n in (one, two))
                for name in here.index.keys() & there.index.keys():
                    pair = (
                        (p, here.unit_of[here.index[name]]),
                        (q, there.unit_of[there.index[name]]),
                    )
                    move = self._problem.move_cost(name, often, self._lasts)
                    moves[pair] = moves.get(pair, 0.0) + move
        return moves

    def _cost(self, some: Solution, held: Solution) -> float:
        """Return what some phases add to the total, the others as they are held."""
        alone = sum(
            self._weights[name] * result.objective.total
            for name, result in some.items()
            if result.objective
        )
        return alone + self._moves(some, {**held, **some})

    def _moves(self, some: Solution, held: Solution) -> float:
        """Return the cost of moves between some phases and those beside them."""
        total, counted = 0.0, set[frozenset[str]]()
        for name, here in some.items():
            for other, often in self._beside[name].items():
                pair = frozenset((name, other))
                if other not in held or pair in counted:
                    continue
                counted.add(pair)
                there = held[other].placement
                total += sum(
                    self._problem.move_cost(component, often, self._lasts)
                    for component, computer in here.placement.items()
                    if there.get(component, computer) != computer
                )
        return total


PHASES_BUDGET = 0.26
"""How long to search by default where there are several phases [s]: with all around it,
0.3 s for 60 components."""
GAIN = 1e-9
"""F that is lower by less is not better: rounding only."""


def solve_phases(  # noqa: PLR0913 - each says how to decide, and has a default
    problem: TaskProblem,
    budget: float | None = None,
    method: str = "auto",
    seed: int = 0,
    *,
    steps: int | None = None,
    fewer: bool = False,
    stop: Ask | None = None,
    why: bool = True,
) -> TaskResult:
    """Return the best placements of all phases found within `budget` [s].

    The parameters are those of `poise.plan.solve`; the budget is 0.1 s unless given,
    and 0.26 s for several phases. A method other than ``auto`` and
    ``search`` places one phase after the other only. A phase in which nothing was
    found, though there may be something, gets the whole budget once.
    """
    begin = perf_counter()
    if budget is None:
        budget = BUDGET if len(problem.phases) == 1 else PHASES_BUDGET
    search = PhaseSearch(
        problem, method, Effort(budget, steps, seed, stop), fewer=fewer
    )
    alone = search.alone()
    result = TaskResult(problem, alone)
    weights = problem.weights
    bounds = [
        weights[name] * result.bound
        for name, result in alone.items()
        if result.bound is not None
    ]
    bound = sum(bounds) if len(bounds) == len(alone) else None
    if result.moves:
        held = {name: result for name, result in alone.items() if result.feasible}
        better = search.chained(held)
        if method in {"auto", "search"}:
            enough = -inf if bound is None else bound + GAIN
            better = search.together(better, enough)
        if search.total(better) < search.total(held) - GAIN:
            changed = {
                name: result
                for name, result in better.items()
                if result.placement != alone[name].placement
            }
            result = TaskResult(problem, {**alone, **changed})
    if why and method != "greedy":
        for r in result.results.values():
            r.find_conflict(stop)
    if not result.feasible:
        result.proven = any(r.proven for r in alone.values() if not r.feasible)
    elif bound is not None and result.total is not None:
        # Nothing is below phases that do without moves.
        result.bound = min(bound, result.total)
        result.proven = result.total <= bound + GAIN
    if search.interrupted:
        result.stopped_by = "interrupted"
    result.seconds = perf_counter() - begin
    return result


Unit = tuple[int, int]
"""A phase, and a unit in it."""


def weighted(part: Arrays, weight: float) -> Arrays:
    """Return arrays whose F counts `weight` times."""
    times = part.times and replace(
        part.times,
        limits=[
            (limit, weight * price, *others)
            for limit, price, *others in part.times.limits
        ],
    )
    return replace(
        part,
        times=times,
        communication=weight * part.communication,
        spread=[weight * spread for spread in part.spread],
        price=[weight * price for price in part.price],
        cost=[weight * cost for cost in part.cost],
    )


def merged(parts: Sequence[Arrays], moves: Mapping[tuple[Unit, Unit], float]) -> Arrays:
    """Return the arrays of several phases as those of one problem.

    Its F is the sum over the phases, and of `moves` (pairs of units -> what being apart
    costs). The bandwidth of links is left out; distances count for moves, too.
    """
    begin = [0, *accumulate(part.n for part in parts)]
    columns = [0, *accumulate(part.r for part in parts)]
    start = [0, *accumulate(len(part.unit_of) for part in parts)]
    a = parts[0]
    pairs = [(part, begin[p]) for p, part in enumerate(parts)]
    inside = [
        (i + at, j + at, part.communication * overhead, 0.0)
        for part, at in pairs
        for i, j, overhead, _ in part.connectors
    ]
    across = [
        (begin[p] + u, begin[q] + v, move, 0.0)
        for ((p, u), (q, v)), move in moves.items()
    ]
    return Arrays(
        a.problem,
        [
            tuple(i + start[p] for i in inside_unit)
            for p, part in enumerate(parts)
            for inside_unit in part.members
        ],
        [u + at for part, at in pairs for u in part.unit_of],
        {
            f"{p}.{name}": i + start[p]
            for p, part in enumerate(parts)
            for name, i in part.index.items()
        },
        _own([part.component_demand for part in parts], columns),
        tuple(f"{p}.{name}" for p, part in enumerate(parts) for name in part.resources),
        _own([part.demand for part in parts], columns),
        _by_computer([part.capacity for part in parts], columns),
        _by_computer([part.limit for part in parts], columns),
        [price for part in parts for price in part.price],
        [weight for part in parts for weight in part.size_weight],
        {u + at: hosts for part, at in pairs for u, hosts in part.allowed.items()},
        [*inside, *across],
        a.distance,
        _costs(parts),
        [],
        [(i + at, j + at) for part, at in pairs for i, j in part.apart],
        0.0,
        0.0,
        1.0,
        [weight for part in parts for weight in part.spread],
        a.share,
        a.variance,
        begin[-1],
        a.m,
        columns[-1],
        _times(parts, start, columns),
    )


def _times(
    parts: Sequence[Arrays], start: Sequence[int], columns: Sequence[int]
) -> Times | None:
    """Return the time limits of all phases, each with the CPU of its own phase."""
    limits: list[LimitArray] = []
    times = None
    for p, part in enumerate(parts):
        times = part.times or times
        for limit, price, fixed, cpu, runs, hops in (
            part.times.limits if part.times else ()
        ):
            shares = cpu + columns[p] if cpu >= 0 else -1
            moved = [(component + start[p], seconds) for component, seconds in runs]
            ways = [(hop[0] + start[p], hop[1] + start[p], *hop[2:]) for hop in hops]
            limits.append((limit, price, fixed, shares, moved, ways))
    return times and replace(times, limits=limits)


def _own(tables: Sequence[Sequence[float]], columns: Sequence[int]) -> list[float]:
    """Return rows in which each phase has columns of its own, from `columns` on."""
    out: list[float] = []
    for table, begin, end in zip(tables, columns, columns[1:], strict=False):
        before, after = [0.0] * begin, [0.0] * (columns[-1] - end)
        for row in _rows(table, end - begin):
            out += [*before, *row, *after]
    return out


def _by_computer(
    tables: Sequence[Sequence[float]], columns: Sequence[int]
) -> list[float]:
    rows = [
        _rows(table, end - begin)
        for table, begin, end in zip(tables, columns, columns[1:], strict=False)
    ]
    return [
        x for beside in zip_longest(*rows, fillvalue=()) for row in beside for x in row
    ]


def _rows(table: Sequence[float], width: int) -> list[Sequence[float]]:
    return [table[i : i + width] for i in range(0, len(table), width or 1)]


def _costs(parts: Sequence[Arrays]) -> list[float]:
    if not any(part.cost for part in parts):
        return []
    return [cost for part in parts for cost in (part.cost or [0.0] * (part.n * part.m))]
