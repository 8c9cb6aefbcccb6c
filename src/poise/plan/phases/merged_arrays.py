"""The arrays of several phases as those of one problem."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate

from msgspec.structs import replace

from poise.plan.problem.arrays import Arrays
from poise.plan.problem.time_arrays import LimitArray, Times

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
        spread=[weight * each for each in part.spread],
        price=[weight * each for each in part.price],
        cost=[weight * each for each in part.cost],
    )


def merged(parts: Sequence[Arrays], moves: Mapping[tuple[Unit, Unit], float]) -> Arrays:
    """Return the arrays of several phases as those of one problem.

    Its F is the sum over the phases, and of `moves` (pairs of units -> what being apart
    costs). The bandwidth of links is left out; distances count for moves, too.
    """
    begin = [0, *accumulate(part.n for part in parts)]
    start = [0, *accumulate(len(part.unit_of) for part in parts)]
    a, count = parts[0], len(parts)
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
        _own([part.component_demand for part in parts], a.r),
        tuple(f"{p}.{name}" for p in range(count) for name in a.resources),
        _own([part.demand for part in parts], a.r),
        _by_computer([part.capacity for part in parts], a),
        _by_computer([part.limit for part in parts], a),
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
        a.r * count,
        _times(parts, start),
    )


def _times(parts: Sequence[Arrays], start: Sequence[int]) -> Times | None:
    """Return the time limits of all phases, each with the CPU of its own phase."""
    limits: list[LimitArray] = []
    times = None
    for p, part in enumerate(parts):
        times = part.times or times
        for limit, price, fixed, cpu, runs, hops in (
            part.times.limits if part.times else ()
        ):
            shares = cpu + p * part.r if cpu >= 0 else -1
            moved = [(component + start[p], seconds) for component, seconds in runs]
            ways = [(hop[0] + start[p], hop[1] + start[p], *hop[2:]) for hop in hops]
            limits.append((limit, price, fixed, shares, moved, ways))
    return times and replace(times, limits=limits)


def _own(tables: Sequence[Sequence[float]], r: int) -> list[float]:
    """Return rows in which each phase has columns of its own."""
    out: list[float] = []
    for p, table in enumerate(tables):
        before, after = [0.0] * (p * r), [0.0] * ((len(tables) - p - 1) * r)
        for row in range(0, len(table), r or 1):
            out += [*before, *table[row : row + r], *after]
    return out


def _by_computer(tables: Iterable[Sequence[float]], a: Arrays) -> list[float]:
    tables = tuple(tables)
    return [
        value
        for h in range(a.m)
        for table in tables
        for value in table[h * a.r : (h + 1) * a.r]
    ]


def _costs(parts: Sequence[Arrays]) -> list[float]:
    if not any(part.cost for part in parts):
        return []
    return [cost for part in parts for cost in (part.cost or [0.0] * (part.n * part.m))]
