"""Why nothing can hold: a few components and limits, and the cheapest way out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.robot import Objective
from poise.plan.change import keep_components
from poise.plan.engine import Ask, Engine
from poise.plan.limits import obstacle
from poise.plan.objective import loads
from poise.plan.problem import Problem
from poise.plan.relief import Limit, Relief, limits_of
from poise.plan.result import Conflict
from poise.plan.tables import Placed, Tables, fits, tabulate

STEPS = 10_000
"""How many nodes or search moves one question may take."""
ALL_STEPS = 2_000_000
"""How many all proofs together may take, about a second."""
MOST_COMPONENTS = 60
"""Up to how many components are left out one by one, to find those that conflict."""


class Shortage(NamedTuple):
    """Units that may run on some computers only, and need more than those have."""

    units: list[int]
    computers: list[int]
    resource: int


class Oracle:
    """Answers whether a problem can hold, as far as that takes no long time."""

    def __init__(self, stop: Ask | None = None) -> None:
        self._stop = stop
        self._left = ALL_STEPS

    def impossible(self, problem: Problem) -> bool:
        """Whether it is proven that no placement keeps all limits."""
        placed, proven = self._ask(problem)
        return proven and placed is None

    def placement(self, problem: Problem) -> Placed | None:
        """Return a placement that keeps all limits, if one is found."""
        return self._ask(problem)[0]

    def _ask(self, problem: Problem) -> tuple[Placed | None, bool]:
        self._left -= len(problem.components) * len(problem.computers)
        if self._left <= 0 or (self._stop is not None and self._stop()):
            return None, False
        aimless = replace(problem, objective=Objective(communication=0.0, balance=0.0))
        tables = tabulate(replace(aimless, cost=()))
        if not tables.n:
            return [], True
        if next(_shortages(tables), None) is not None:
            return None, True
        engine = Engine(tables)
        answer = None
        if engine.provable:
            answer = engine.exact([], steps=STEPS)
            self._left -= answer.steps
        if answer is None or not (answer.placed or answer.proven):
            answer = engine.search([], steps=STEPS)
            self._left -= answer.steps
        return answer.placed or None, answer.proven


def dead_end(tables: Tables, placed: Placed, order: list[int]) -> str:
    """Return where the greedy came to a dead end, and why."""
    unit = next(u for u in order if placed[u] < 0)
    load = loads(tables, placed)
    why = "; ".join(
        f"{computer.name}: {obstacle(tables, placed, load, unit, h)}"
        for h, computer in enumerate(tables.problem.computers)
    )
    return f"the greedy finds no computer for {_names(tables, [unit])[0]} ({why})"


def conflict(problem: Problem, stop: Ask | None = None) -> Conflict | None:
    """Return a small set of components and limits that cannot hold together.

    None when it cannot be proven in short time that there is one, or when `stop` says
    that it is enough.
    """
    oracle = Oracle(stop)
    found = _limits_in_conflict(problem, oracle)
    if found is None:
        return None
    part, limits = found
    way = Relief(oracle, lambda p: _limits_in_conflict(p, oracle)).find(problem, limits)
    return Conflict(
        components=tuple(c.name for c in part.components),
        limits=_sentences(part, limits),
        way_out=str(way) or _at_least(part),
        more=way.more(),
    )


def _limits_in_conflict(
    problem: Problem, oracle: Oracle
) -> tuple[Problem, list[Limit]] | None:
    """Return a part of the problem that cannot hold, and the limits that it breaks.

    As small as possible, so far as the oracle can tell: without any one of its
    components, or of the limits, it can hold.
    """
    tables = tabulate(problem)
    shortage = min(_shortages(tables), key=lambda s: len(s.units), default=None)
    if shortage is not None:
        part = keep_components(problem, set(_names(tables, shortage.units)))
    elif len(problem.components) <= MOST_COMPONENTS:
        part = problem
    else:
        return None
    if len(part.components) > MOST_COMPONENTS:
        return part, [k for k in limits_of(part) if k.names in _short(tables, shortage)]
    if not oracle.impossible(part):
        return None
    for component in sorted(part.components, key=lambda c: sum(c.demand.values())):
        names = {c.name for c in part.components} - {component.name}
        smaller = keep_components(part, names)
        if oracle.impossible(smaller):
            part = smaller
    limits = []
    relaxed = part
    for limit in limits_of(part):
        without = limit.lifted(relaxed)
        if oracle.impossible(without):
            relaxed = without
        else:
            limits.append(limit)
    return part, limits


def _short(tables: Tables, shortage: Shortage | None) -> set[tuple[str, ...]]:
    """Return the computers and the resource that are short, by name."""
    if shortage is None:
        return set()
    resource = tables.resources[shortage.resource]
    return {(tables.problem.computers[h].name, resource) for h in shortage.computers}


def _shortages(tables: Tables) -> Iterator[Shortage]:
    """Yield sets of computers with less than what may run nowhere else needs."""
    everywhere = tuple(range(tables.m))
    alike: dict[tuple[int, ...], list[int]] = {everywhere: []}
    for u in range(tables.n):
        alike.setdefault(tables.allowed.get(u, everywhere), []).append(u)
    need = {
        computers: [
            sum(tables.demand[u * tables.r + k] for u in units) for k in range(tables.r)
        ]
        for computers, units in alike.items()
    }
    for computers, units in alike.items():
        if not computers:
            yield Shortage(units[:1], [], 0)
            continue
        inside = [c for c in alike if {*computers}.issuperset(c)]
        for k in range(tables.r):
            limits = [tables.limit[h * tables.r + k] for h in computers]
            if not fits(sum(need[c][k] for c in inside), sum(limits)):
                bound = [u for c in inside for u in alike[c]]
                yield Shortage(_largest(tables, bound, sum(limits), k), [*computers], k)
            for u in units:
                if not fits(tables.demand[u * tables.r + k], max(limits)):
                    yield Shortage([u], [*computers], k)


def _largest(tables: Tables, units: list[int], limit: float, k: int) -> list[int]:
    """Return the largest of the units, as few as are together beyond the limit."""
    some: list[int] = []
    total = 0.0
    for u in sorted(units, key=lambda u: -tables.demand[u * tables.r + k]):
        if not fits(total, limit):
            break
        some.append(u)
        total += tables.demand[u * tables.r + k]
    return some


def _sentences(part: Problem, limits: list[Limit]) -> tuple[str, ...]:
    """Return the limits for people: what is short as one sum, where it is a sum."""
    tables = tabulate(part)
    short = next((s for s in _shortages(tables) if len(s.units) == tables.n), None)
    if short is None or not short.computers:
        return tuple(limit.text for limit in limits)
    others = (limit.text for limit in limits if limit.kind != "capacity")
    return (_sum_of(tables, short), *others)


def _sum_of(tables: Tables, short: Shortage) -> str:
    k = short.resource
    resource = tables.resources[k]
    names = _names(tables, short.units)
    where = [tables.problem.computers[h].name for h in short.computers]
    need = sum(tables.demand[u * tables.r + k] for u in short.units)
    limits = [tables.limit[h * tables.r + k] for h in short.computers]
    verb = "needs" if len(names) == 1 else "together need"
    sentence = f"{', '.join(names)} {verb} {need:.6g} {resource}"
    if len(where) == 1:
        return f"{sentence}; {where[0]} has {limits[0]:.6g}"
    if fits(need, sum(limits)):
        most = max(range(len(limits)), key=lambda i: limits[i])
        return f"{sentence}; {where[most]} has the most, {limits[most]:.6g}"
    return f"{sentence}; {', '.join(where)} together have {sum(limits):.6g}"


def _at_least(part: Problem) -> str:
    """Return what is short in all, where no way out was found in short time."""
    tables = tabulate(part)
    short = next(_shortages(tables), None)
    if short is None or not short.computers:
        return "none was found in short time"
    k = short.resource
    need = sum(tables.demand[u * tables.r + k] for u in short.units)
    has = sum(tables.limit[h * tables.r + k] for h in short.computers)
    where = " or ".join(tables.problem.computers[h].name for h in short.computers)
    return f"at least {max(need - has, 0.0):.6g} more {tables.resources[k]} on {where}"


def _names(tables: Tables, units: list[int]) -> tuple[str, ...]:
    components = tables.problem.components
    return tuple(components[i].name for u in units for i in tables.members[u])
