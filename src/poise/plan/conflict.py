"""Why nothing can hold: an irreducible infeasible subset, and its relaxation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, isinf
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.hardware import fits
from poise.model.robot import Objective
from poise.plan._core import Core
from poise.plan.problem.arrays import Arrays, arrays_of
from poise.plan.problem.changed_problem import keep_components
from poise.plan.problem.problem import Problem
from poise.plan.relaxation import (
    Limit,
    Relaxation,
    in_words,
    limits_of,
    price,
    relaxed,
    rises,
)
from poise.plan.result_records import Ask, Conflict
from poise.plan.violations import Late, amount_of, late, named

STEPS = 100_000
"""How many nodes, and how many search moves, one question may take."""
ALL_STEPS = 8_000_000
"""How many all proofs together may take, about two seconds."""
MOST_COMPONENTS = 60
"""Up to how many components are left out one by one, to find those that conflict."""


class ShortUnits(NamedTuple):
    """Units that may run on some computers only, and need more than those have."""

    units: list[int]
    computers: list[int]
    resource: int


class Oracle:
    """Answers whether a problem can hold, as far as that takes no long time."""

    def __init__(self, stop: Ask | None = None, share: float = 1.0) -> None:
        self._stop = stop
        self._left = share * ALL_STEPS

    def is_spent(self) -> bool:
        """Return whether it took too many steps, or has to stop."""
        return self._left <= 0 or (self._stop is not None and self._stop())

    def ask(self, problem: Problem) -> bool | None:
        """Return whether some placement keeps all limits; None when it is not known."""
        self._left -= len(problem.components) * len(problem.computers)
        if self.is_spent():
            return None
        problem = replace(
            problem,
            objective=Objective(communication=0.0, balance=0.0),
            time_limits=tuple(t for t in problem.time_limits if not t.price),
        )
        arrays = replace(arrays_of(problem), cost=[])
        if not arrays.n:
            return not _late(arrays)
        if is_hopeless(arrays):
            return False
        core = Core(arrays)
        if core.greedy()[1]:
            return True
        proven = False
        if core.provable:
            placed, _, proven, _, steps = core.exact([], 1e9, STEPS, self._stop)
            self._left -= steps
            if placed or proven:
                return bool(placed)
        placed, *_, steps = core.search([], 1e9, STEPS, 0, self._stop)
        self._left -= steps
        return True if placed else None

    def least(self, problem: Problem) -> Mapping[str, str]:
        """Return a placement of least F, as far as that is found; empty: none is."""
        if self.is_spent():
            return {}
        arrays = arrays_of(problem)
        core = Core(arrays)
        if core.provable:
            placed, *_, steps = core.exact([], 1e9, STEPS, self._stop)
        else:
            placed, *_, steps = core.search([], 1e9, STEPS, 0, self._stop)
        self._left -= steps
        return arrays.placement(placed) if placed else {}


def is_hopeless(arrays: Arrays) -> bool:
    """Whether it clearly cannot hold."""
    is_short = next(_shortages(arrays), None) is not None
    return is_short or bool(_late(arrays)) or any(_rivals(arrays.problem))


def _rivals(problem: Problem) -> Iterator[tuple[str, ...]]:
    """Yield components that an exclusive device keeps from running at once."""
    return (users for users in problem.exclusive.values() if len(users) > 1)


def _late(arrays: Arrays) -> dict[str, Late]:
    """Return the time limits that no placement keeps, as far as pins tell."""
    if arrays.times is None:
        return {}
    placed = [-1] * arrays.n
    for unit, computers in arrays.allowed.items():
        if len(computers) == 1:
            placed[unit] = computers[0]
    return late(arrays, placed)


def conflict(
    problem: Problem, stop: Ask | None = None, share: float = 1.0
) -> Conflict | None:
    """Return a small set of components and limits that cannot hold together.

    None when it cannot be proven in short time (a `share` of `ALL_STEPS`) that there is
    one, or when `stop` says that it is enough.
    """
    oracle = Oracle(stop, share)
    subset = _infeasible_subset(problem, oracle)
    if subset is None:
        return None
    part, limits, irreducible = subset
    relaxation = Relaxation(oracle, lambda p: _infeasible_subset(p, oracle))
    raises = relaxation.find(problem, limits)
    return Conflict(
        components=tuple(c.name for c in part.components),
        limits=_sentences(part, limits),
        relaxation=in_words(raises) or _at_least(part),
        irreducible=irreducible,
        more=rises(raises),
        price=None if isinf(least := price(problem, raises)) else least,
    )


def _infeasible_subset(
    problem: Problem, oracle: Oracle
) -> tuple[Problem, list[Limit], bool] | None:
    """Return a part of the problem that cannot hold, and the limits that it breaks.

    And whether it is irreducible: without any one of its components, or of the limits,
    it is known to hold.
    """
    arrays = arrays_of(problem)
    shortage = min(_shortages(arrays), key=lambda s: len(s.units), default=None)
    hopeless = next(_hopeless(problem, arrays), None)
    if shortage is not None:
        part = keep_components(problem, set(arrays.names(shortage.units)))
    elif hopeless is not None:
        part = hopeless
    elif len(problem.components) <= MOST_COMPONENTS:
        part = problem
    else:
        return None
    if len(part.components) > MOST_COMPONENTS:
        short = [k for k in limits_of(part) if k.names in _short(arrays, shortage)]
        return part, short, False
    if oracle.ask(part) is not False:
        return None
    irreducible = True
    for component in sorted(part.components, key=lambda c: sum(c.demand.values())):
        names = {c.name for c in part.components} - {component.name}
        smaller = keep_components(part, names)
        holds = oracle.ask(smaller)
        irreducible = irreducible and holds is not None
        if holds is False:
            part = smaller
    limits: list[Limit] = []
    lifted: dict[Limit, float] = {}
    for limit in limits_of(part):
        holds = oracle.ask(relaxed(part, {**lifted, limit: inf}))
        irreducible = irreducible and holds is not None
        if holds is False:
            lifted[limit] = inf
        else:
            limits.append(limit)
    return part, limits, irreducible


def _hopeless(problem: Problem, arrays: Arrays) -> Iterator[Problem]:
    """Yield parts that need an exclusive device, or by pins break a time limit."""
    for users in _rivals(problem):
        yield keep_components(problem, {*users})
    broken = _late(arrays)
    for limit in problem.time_limits:
        if limit.name in broken and len(limit.components) <= MOST_COMPONENTS:
            part = keep_components(problem, {*limit.components})
            if _late(arrays_of(part)):
                yield part


def _short(arrays: Arrays, shortage: ShortUnits | None) -> set[tuple[str, ...]]:
    """Return the computers and the resource that are short, by name."""
    if shortage is None:
        return set()
    resource = arrays.resources[shortage.resource]
    return {(arrays.problem.computers[h].name, resource) for h in shortage.computers}


def _shortages(arrays: Arrays) -> Iterator[ShortUnits]:
    """Yield sets of computers with less than what may run nowhere else needs."""
    everywhere = tuple(range(arrays.m))
    alike: dict[tuple[int, ...], list[int]] = {everywhere: []}
    for u in range(arrays.n):
        alike.setdefault(arrays.allowed.get(u, everywhere), []).append(u)
    need = {
        computers: [
            sum(arrays.demand[u * arrays.r + k] for u in units)
            for k in range(len(arrays.resources))
        ]
        for computers, units in alike.items()
    }
    for computers, units in alike.items():
        if not computers:
            yield ShortUnits(units[:1], [], 0)
            continue
        inside = [c for c in alike if {*computers}.issuperset(c)]
        for k in range(len(arrays.resources)):
            limits = [arrays.limit[h * arrays.r + k] for h in computers]
            if not fits(sum(need[c][k] for c in inside), sum(limits)):
                bound = [u for c in inside for u in alike[c]]
                yield ShortUnits(
                    _largest(arrays, bound, sum(limits), k), [*computers], k
                )
            for u in units:
                if not fits(arrays.demand[u * arrays.r + k], max(limits)):
                    yield ShortUnits([u], [*computers], k)


def _largest(arrays: Arrays, units: list[int], limit: float, k: int) -> list[int]:
    """Return the largest of the units, as few as are together beyond the limit."""
    some: list[int] = []
    total = 0.0
    for u in sorted(units, key=lambda u: -arrays.demand[u * arrays.r + k]):
        if not fits(total, limit):
            break
        some.append(u)
        total += arrays.demand[u * arrays.r + k]
    return some


def _sentences(part: Problem, limits: list[Limit]) -> tuple[str, ...]:
    """Return the limits for people: what is short as one sum, where it is a sum."""
    arrays = arrays_of(part)
    short = next((s for s in _shortages(arrays) if len(s.units) == arrays.n), None)
    if short is None or not short.computers:
        broken = _late(arrays)
        return tuple(
            broken[limit.names[0]].text
            if limit.kind == "time" and limit.names[0] in broken
            else limit.text
            for limit in limits
        )
    others = (limit.text for limit in limits if limit.kind != "capacity")
    return (_sum_of(arrays, short), *others)


def _sum_of(arrays: Arrays, short: ShortUnits) -> str:
    k = short.resource
    resource = arrays.resources[k]
    names = arrays.names(sorted(short.units))
    where = [arrays.problem.computers[h].name for h in short.computers]
    need = sum(arrays.demand[u * arrays.r + k] for u in short.units)
    limits = [arrays.limit[h * arrays.r + k] for h in short.computers]
    verb = "needs" if len(names) == 1 else "together need"
    sentence = f"{named(names)} {verb} {amount_of(resource, need)} {resource}"
    if len(where) == 1:
        return f"{sentence}; {where[0]} has {amount_of(resource, limits[0])}"
    if fits(need, sum(limits)):
        most = max(range(len(limits)), key=lambda i: limits[i])
        has = amount_of(resource, limits[most])
        return f"{sentence}; {where[most]} has the most, {has}"
    has = amount_of(resource, sum(limits))
    return f"{sentence}; {', '.join(where)} together have {has}"


def _at_least(part: Problem) -> str:
    """Return what is short in all, where no relaxation was found in short time."""
    arrays = arrays_of(part)
    short = next(_shortages(arrays), None)
    if short is None or not short.computers:
        return "limits that were not found in short time"
    k = short.resource
    needs = [arrays.demand[u * arrays.r + k] for u in short.units]
    has = [arrays.limit[h * arrays.r + k] for h in short.computers]
    missing = max(sum(needs) - sum(has), max(needs) - max(has))
    where = " or ".join(arrays.problem.computers[h].name for h in short.computers)
    resource = arrays.resources[k]
    return f"at least {amount_of(resource, missing)} more {resource} on {where}"
