"""Why nothing can hold: an irreducible infeasible subset, and its relaxation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil, floor, inf, isinf, log10
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.hardware import fits
from poise.model.robot import Objective
from poise.plan._core import Core
from poise.plan.problem.arrays import Arrays, arrays_of
from poise.plan.problem.changed_problem import keep_components
from poise.plan.problem.problem import Problem
from poise.plan.problem_limits import (
    Limit,
    Raises,
    in_words,
    limits_of,
    price,
    relaxed,
    rises,
    share_of,
    softened,
    usual,
)
from poise.plan.result_records import Ask, Conflict
from poise.plan.violations import Late, amount_of, late, named

STEPS = 100_000
"""How many nodes, and how many search moves, one question may take."""
ALL_STEPS = 8_000_000
"""How many all proofs together may take, about two seconds."""
MOST_COMPONENTS = 60
"""Up to how many components are left out one by one, to find those that conflict."""
NEAR = 5e-3
"""How close a raise comes to the least that is enough, relative to it."""
SIMPLER = 0.95
"""Several limits are raised instead of one if they take less than this share of it."""
MOST_TRIES = 64
"""How many single limits are tried to be raised."""


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
    raises = _Relaxation(oracle).find(problem, limits)
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
    """Return a part that cannot hold, limits it breaks, and if both are irreducible."""
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


class _Relaxation:
    """Looks for the smallest relaxation: which limits must give way, by how much."""

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle

    def find(self, problem: Problem, limits: list[Limit]) -> Raises:
        """Return what has to give way, so that the whole problem holds; or nothing."""
        whole = list(limits_of(problem))
        limits = [next(k for k in whole if k.covers(limit)) for limit in limits]
        ways: list[Raises] = [
            {limit: self._at_most(problem, limit, limit.most)}
            for limit in limits[:MOST_TRIES]
            if limit.most > 0 and self._holds(problem, {limit: inf})
        ]
        one = min(ways, key=lambda way: price(problem, way), default=None)
        several = self._capacities(problem) or self._several(problem, limits)
        if one is None or price(problem, several) < SIMPLER * price(problem, one):
            return several
        return one

    def _capacities(self, problem: Problem) -> Raises:
        """Return the least rises of capacities that are enough, if any are."""
        soft = [k for k in limits_of(problem) if k.kind == "capacity"]
        if len(soft) > MOST_TRIES or len(problem.components) > MOST_TRIES:
            return {}
        placement = self._oracle.least(softened(problem, soft))
        raises: dict[Limit, float] = {}
        for limit in soft if placement else ():
            computer, resource = limit.names
            h = next(h for h in problem.computers if h.name == computer)
            used = sum(
                c.demand.get(resource, 0.0)
                for c in problem.components
                if placement[c.name] == computer
            )
            if not fits(used, usable := h.usable(resource)):
                raises[limit] = (used - usable) / share_of(h, resource)
        for limit, enough in list(raises.items()):
            others = {k: more for k, more in raises.items() if k is not limit}
            raises[limit] = self._at_most(relaxed(problem, others), limit, enough)
        return raises if self._holds(problem, raises) else {}

    def _several(self, problem: Problem, limits: list[Limit]) -> Raises:
        """Lift what is in conflict, over and over; then take back what was needless."""
        chosen: list[Limit] = []
        while not self._holds(problem, dict.fromkeys(chosen, inf)):
            lifted = [limit for limit in limits if limit.most > 0] or limits[-1:]
            if not lifted:
                return {}
            chosen += lifted
            rest = relaxed(problem, dict.fromkeys(chosen, inf))
            subset = _infeasible_subset(rest, self._oracle)
            limits = [
                limit
                for limit in limits_of(problem)
                if subset and any(limit.covers(other) for other in subset[1])
                if limit not in chosen
            ]
        return self._with_less(problem, chosen)

    def _with_less(self, problem: Problem, chosen: list[Limit]) -> Raises:
        """Return a relaxation of some of these limits: none more than is needed."""
        for limit in [k for k in chosen if k.advice]:
            others = [other for other in chosen if other is not limit]
            if self._holds(problem, dict.fromkeys(others, inf)):
                chosen = others
        lifts: Raises = dict.fromkeys((k for k in chosen if k.advice), inf)
        soft = sorted((k for k in chosen if not k.advice), key=lambda k: k.names)
        if not soft or self._holds(problem, lifts):
            return lifts
        # All alike first, in shares of what is usual; then one by one.
        units = {k: usual(problem, k) for k in soft}
        low, high = 0.0, max(k.most / unit for k, unit in units.items())
        while high - low > NEAR * high:
            share = (low + high) / 2
            raises = {k: share * unit for k, unit in units.items()}
            if self._holds(problem, {**raises, **lifts}):
                high = share
            else:
                low = share
        raises = {k: high * unit for k, unit in units.items()}
        for limit in soft:
            enough = raises.pop(limit)
            rest = relaxed(problem, {**raises, **lifts})
            raises[limit] = self._at_most(rest, limit, enough)
        return {**{k: more for k, more in raises.items() if more > 0}, **lifts}

    def _at_most(self, problem: Problem, limit: Limit, enough: float) -> float:
        """Return as small a raise as is found, given one that is enough."""
        if self._oracle.is_spent():
            return enough
        if self._holds(problem, {}):
            return 0.0
        low, high = 0.0, enough
        while high - low > NEAR * high:
            middle = (low + high) / 2
            if self._holds(problem, {limit: middle}):
                high = middle
            elif self._oracle.is_spent():
                return high
            else:
                low = middle
        # The roundest number that is enough; one that is no less than `high` is.
        for digits in (1, 2, 3):
            step = 10.0 ** (floor(log10(high)) + 1 - digits)
            rounded = ceil(low / step + 1e-9) * step
            if rounded <= high and self._holds(problem, {limit: rounded}):
                return rounded
        return ceil(high / step - 1e-9) * step

    def _holds(self, problem: Problem, raises: Raises) -> bool:
        return self._oracle.ask(relaxed(problem, raises)) is True
