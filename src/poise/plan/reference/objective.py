"""The objective F, term by term: the specification (docs/design/objective.md).

F(x) = communication * sum of overhead * distance over pairs that are apart
     + sum over resources of weight * spread of the residue over all computers
     + sum of linear costs

The paper's eq. 1 is the case of scale ``paper``, one resource and no linear cost.
"""

from __future__ import annotations

from poise.plan.records import Terms
from poise.plan.tables import Placed, Tables


def terms(tables: Tables, placed: Placed) -> Terms:
    """Return F of a placement; units without a computer (-1) contribute nothing."""
    communication = tables.communication * crossing(tables, placed)
    balance = spread(tables, loads(tables, placed))
    move = linear(tables, placed)
    return Terms(
        total=communication + balance + move,
        communication=communication,
        balance=balance,
        move=move,
    )


def crossing(tables: Tables, placed: Placed) -> float:
    """Return the overhead, times distance, of all connectors whose ends are apart."""
    total = 0.0
    for i, j, overhead in zip(
        tables.first, tables.second, tables.overhead, strict=True
    ):
        a, b = placed[i], placed[j]
        if a >= 0 and b >= 0:
            total += overhead * distance(tables, a, b)
    return total


def distance(tables: Tables, a: int, b: int) -> float:
    """Return what a unit of overhead costs between computers `a` and `b`."""
    if tables.distance:
        return tables.distance[a * tables.m + b]
    return 0.0 if a == b else 1.0


def loads(tables: Tables, placed: Placed) -> list[float]:
    """Return what is used, (m, r)."""
    r = tables.r
    total = [0.0] * (tables.m * r)
    for unit, computer in enumerate(placed):
        if computer >= 0:
            for k in range(r):
                total[computer * r + k] += tables.demand[unit * r + k]
    return total


def spread(tables: Tables, load: list[float]) -> float:
    """Return the weighted spread of the residue over all computers."""
    return sum(
        weight * _spread_of(residues(tables, load, k), variance=tables.variance)
        for k, weight in enumerate(tables.spread)
        if weight > 0
    )


def residues(tables: Tables, load: list[float], resource: int) -> list[float]:
    """Return what is left of a resource, by computer.

    As a share of capacity in the normalised scale; computers that have none of the
    resource then have no share and are left out.
    """
    r = tables.r
    capacity, used = tables.capacity[resource::r], load[resource::r]
    if tables.share:
        return [(c - u) / c for c, u in zip(capacity, used, strict=True) if c > 0]
    return [c - u for c, u in zip(capacity, used, strict=True)]


def _spread_of(residue: list[float], *, variance: bool) -> float:
    if not residue:
        return 0.0
    if not variance:
        return max(residue) - min(residue)
    mean = sum(residue) / len(residue)
    return sum((x - mean) ** 2 for x in residue) / len(residue)


def linear(tables: Tables, placed: Placed) -> float:
    """Return the linear costs: of moving, and of the problem's cost matrix."""
    if not tables.cost:
        return 0.0
    return sum(
        tables.cost[unit * tables.m + computer]
        for unit, computer in enumerate(placed)
        if computer >= 0
    )
