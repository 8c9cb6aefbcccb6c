"""Why nothing can hold: a few components and limits, and the cheapest way out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.robot import Objective
from poise.plan.change import keep_components
from poise.plan.engine import Engine
from poise.plan.limits import obstacle
from poise.plan.objective import loads
from poise.plan.problem import Problem
from poise.plan.result import Conflict
from poise.plan.tables import Placed, Tables, fits, tabulate

STEPS = 20_000
"""How many nodes a proof may take while a conflict is made smaller."""
MOST_COMPONENTS = 60
"""How many components a conflict is looked for among by leaving out one at a time."""


class Shortage(NamedTuple):
    """Units that may run on some computers only, and need more than those have."""

    units: list[int]
    computers: list[int]
    resource: int
    short: float


def dead_end(tables: Tables, placed: Placed, order: list[int]) -> str:
    """Return where the greedy came to a dead end, and why."""
    unit = next(u for u in order if placed[u] < 0)
    load = loads(tables, placed)
    why = "; ".join(
        f"{computer.name}: {obstacle(tables, placed, load, unit, h)}"
        for h, computer in enumerate(tables.problem.computers)
    )
    return f"the greedy finds no computer for {_names(tables, [unit])[0]} ({why})"


def conflict(problem: Problem) -> Conflict | None:
    """Return a small set of components and limits that cannot hold together.

    None when it cannot be proven in short time that there is one.
    """
    tables = tabulate(problem)
    for i, computers in tables.allowed.items():
        if not computers:
            names = _names(tables, [i])
            return Conflict(
                components=names,
                limits=(f"{' and '.join(names)} may run on no common computer",),
                way_out="let them run apart, or on more computers",
            )
    for i, j in tables.apart:
        if i == j:
            names = _names(tables, [i])
            return Conflict(
                components=names,
                limits=(f"{' and '.join(names)} must be together, and apart",),
                way_out="drop one of the two",
            )
    shortage = min(_shortages(tables), key=lambda s: len(s.units), default=None)
    if shortage is not None:
        return _explained(tables, shortage)
    if len(problem.components) > MOST_COMPONENTS:
        return None
    return _by_leaving_out(problem)


def _shortages(tables: Tables) -> Iterator[Shortage]:
    """Yield sets of computers with less than what may run nowhere else needs."""
    everywhere = tuple(range(tables.m))
    sets = {tables.allowed.get(u, everywhere) for u in range(tables.n)}
    for computers in sets | {everywhere}:
        bound = [
            u
            for u in range(tables.n)
            if set(tables.allowed.get(u, everywhere)) <= set(computers)
        ]
        for k in range(tables.r):
            yield from _short_of(tables, bound, list(computers), k)
    for u in range(tables.n):
        yield from _too_large(tables, u)


def _short_of(
    tables: Tables, units: list[int], computers: list[int], k: int
) -> Iterator[Shortage]:
    limit = sum(tables.limit[h * tables.r + k] for h in computers)
    demand = {u: tables.demand[u * tables.r + k] for u in units}
    if fits(sum(demand.values()), limit):
        return
    # The largest are enough to overfill them.
    some: list[int] = []
    total = 0.0
    for u in sorted(units, key=lambda u: -demand[u]):
        some.append(u)
        total += demand[u]
        if not fits(total, limit):
            break
    yield Shortage(some, computers, k, sum(demand.values()) - limit)


def _too_large(tables: Tables, unit: int) -> Iterator[Shortage]:
    computers = tables.allowed.get(unit, tuple(range(tables.m)))
    for k in range(tables.r):
        need = tables.demand[unit * tables.r + k]
        most = max(computers, key=lambda h: tables.limit[h * tables.r + k])
        has = tables.limit[most * tables.r + k]
        if not fits(need, has):
            yield Shortage([unit], [most], k, need - has)


def _explained(tables: Tables, shortage: Shortage) -> Conflict:
    names = _names(tables, shortage.units)
    where = [tables.problem.computers[h].name for h in shortage.computers]
    resource = tables.resources[shortage.resource]
    need = sum(tables.demand[u * tables.r + shortage.resource] for u in shortage.units)
    has = sum(
        tables.limit[h * tables.r + shortage.resource] for h in shortage.computers
    )
    verb = "needs" if len(names) == 1 else "together need"
    place = where[0] if len(where) == 1 else f"{', '.join(where)} together"
    lacking = f"{', '.join(names)} {verb} {need:.6g} {resource}"
    choices = " or ".join(where)
    held = ""
    if len(shortage.units) == 1 and len(where) == 1 and tables.m > 1:
        held = ", the most of all it may run on"
    return Conflict(
        components=names,
        limits=(f"{lacking}; {place} has {has:.6g}{held}",),
        way_out=f"at least {shortage.short:.6g} more {resource} on {choices}",
    )


def _names(tables: Tables, units: list[int]) -> tuple[str, ...]:
    components = tables.problem.components
    return tuple(components[i].name for u in units for i in tables.members[u])


def _by_leaving_out(problem: Problem) -> Conflict | None:
    """Leave out components, then limits, while it stays proven that nothing holds."""
    problem = replace(problem, objective=Objective(communication=0.0, balance=0.0))
    if not _impossible(problem):
        return None
    whole = problem
    for component in sorted(problem.components, key=lambda c: sum(c.demand.values())):
        names = {c.name for c in problem.components} - {component.name}
        smaller = keep_components(problem, names)
        if _impossible(smaller):
            problem = smaller
    limits: list[str] = []
    for text, relaxed in _relaxed(problem):
        if not _impossible(relaxed(problem)):
            limits.append(text)
        else:
            problem = relaxed(problem)
    return Conflict(
        components=tuple(c.name for c in problem.components),
        limits=tuple(limits),
        way_out=_way_out(whole),
    )


def _impossible(problem: Problem) -> bool:
    """Whether it is proven that no placement keeps all limits."""
    tables = tabulate(problem)
    if any(not computers for computers in tables.allowed.values()):
        return True
    engine = Engine(tables)
    if not engine.provable:
        return False
    answer = engine.exact([], steps=STEPS)
    return answer.proven and not answer.placed and tables.n > 0


def _possible(problem: Problem) -> bool:
    """Whether a placement that keeps all limits is found in short time."""
    tables = tabulate(problem)
    return bool(Engine(tables).exact([], steps=STEPS).placed)


Relax = Callable[[Problem], Problem]


def _relaxed(problem: Problem) -> Iterator[tuple[str, Relax]]:
    """Yield each limit, in words, and how to lift it."""
    for resource in problem.resources:
        for h in problem.computers:
            has = h.capacity.get(resource, 0.0)
            text = f"{h.name} has {has:.6g} {resource}"
            yield text, _lift_capacity(h.name, resource)
    for c in problem.components:
        if c.only:
            why = f" ({c.why})" if c.why else ""
            text = f"{c.name} may only run on {' or '.join(c.only)}{why}"
            yield text, _lift_pin(c.name)
    for link in problem.links:
        text = f"link {' - '.join(link.between)} carries {link.bandwidth:.6g} B/s"
        yield text, _lift(links=tuple(k for k in problem.links if k != link))
    for group in problem.together:
        if len(group) > 1:
            rest = tuple(g for g in problem.together if g != group)
            yield f"together: {', '.join(group)}", _lift(together=rest)
    for group in problem.apart:
        if len(group) > 1:
            rest = tuple(g for g in problem.apart if g != group)
            yield f"apart: {', '.join(group)}", _lift(apart=rest)


def _lift(**fields: object) -> Relax:
    return lambda problem: replace(problem, **fields)


def _lift_capacity(computer: str, resource: str) -> Relax:
    def relax(problem: Problem) -> Problem:
        total = sum(c.demand.get(resource, 0.0) for c in problem.components)
        return with_more(problem, computer, resource, total)

    return relax


def with_more(problem: Problem, computer: str, resource: str, more: float) -> Problem:
    """Return the problem with `more` of a resource usable on a computer."""
    return replace(
        problem,
        computers=tuple(
            h
            if h.name != computer
            else replace(
                h,
                capacity={
                    **h.capacity,
                    resource: h.capacity.get(resource, 0.0)
                    + more
                    / (h.speed if resource == "cpu" else 1.0)
                    / (1 - h.reserve.get(resource, 0.0)),
                },
            )
            for h in problem.computers
        ),
    )


def _lift_pin(name: str) -> Relax:
    def relax(problem: Problem) -> Problem:
        return replace(
            problem,
            components=tuple(
                replace(c, only=()) if c.name == name else c for c in problem.components
            ),
        )

    return relax


def _way_out(problem: Problem) -> str:
    """Return the one capacity whose smallest rise, as a share, lets everything hold."""
    best: tuple[float, str] | None = None
    for h in problem.computers:
        for resource in problem.resources:
            more = _least_more(problem, h.name, resource)
            if more is None:
                continue
            share = more / max(h.capacity.get(resource, 0.0), 1e-9)
            text = f"{more:.6g} more {resource} on {h.name}"
            if best is None or share < best[0]:
                best = (share, text)
    return best[1] if best else "no single capacity is enough; lift one of the limits"


def _least_more(problem: Problem, computer: str, resource: str) -> float | None:
    high = sum(c.demand.get(resource, 0.0) for c in problem.components)
    if high <= 0 or not _possible(with_more(problem, computer, resource, high)):
        return None
    low = 0.0
    while high - low > 1e-3 * high:
        middle = (low + high) / 2
        if _possible(with_more(problem, computer, resource, middle)):
            high = middle
        else:
            low = middle
    return high
