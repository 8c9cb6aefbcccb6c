"""The objective F, term by term: the specification (docs/design/objective.md).

F(x) = communication * sum of overhead * distance over pairs that are apart
     + sum over resources of weight * spread of the residue over all computers
     + sum of linear costs
     + sum over soft limits of price * what is used beyond them, over all computers
     + sum over time limits of price * what is beyond them, as a share of them

The paper's eq. 1 is the case of scale ``paper``, one resource and no linear cost.
"""

from __future__ import annotations

from poise.plan.problem.arrays import Arrays, Placed
from poise.plan.result_records import Terms
from poise.plan.violations import loads
from tests.plan.reference import time


def terms(arrays: Arrays, placed: Placed) -> Terms:
    """Return F of a placement; units without a computer (-1) contribute nothing.

    But to how long something takes they contribute what they take at least.
    """
    communication = arrays.communication * crossing(arrays, placed)
    balance = spread(arrays, loads(arrays, placed))
    move = linear(arrays, placed)
    beyond = shortage(arrays, loads(arrays, placed))
    late = time.cost(arrays, placed)
    return Terms(
        total=communication + balance + move + beyond + late,
        communication=communication,
        balance=balance,
        move=move,
        shortage=beyond,
        time=late,
    )


def crossing(arrays: Arrays, placed: Placed) -> float:
    """Return the overhead, times distance, of all connectors whose ends are apart."""
    total = 0.0
    for i, j, overhead, _ in arrays.connectors:
        a, b = placed[i], placed[j]
        if a >= 0 and b >= 0:
            total += overhead * distance(arrays, a, b)
    return total


def distance(arrays: Arrays, a: int, b: int) -> float:
    """Return what a unit of overhead costs between computers `a` and `b`."""
    if arrays.distance:
        return arrays.distance[a * arrays.m + b]
    return 0.0 if a == b else 1.0


def spread(arrays: Arrays, load: list[float]) -> float:
    """Return the weighted spread of the residue over all computers."""
    return sum(
        weight * _spread_of(residues(arrays, load, k), variance=arrays.variance)
        for k, weight in enumerate(arrays.spread)
        if weight > 0
    )


def residues(arrays: Arrays, load: list[float], resource: int) -> list[float]:
    """Return what is left of a resource, by computer.

    As a share of capacity in the normalised scale; computers that have none of the
    resource then have no share and are left out.
    """
    r = arrays.r
    capacity, used = arrays.capacity[resource::r], load[resource::r]
    if arrays.share:
        return [(c - u) / c for c, u in zip(capacity, used, strict=True) if c > 0]
    return [c - u for c, u in zip(capacity, used, strict=True)]


def _spread_of(residue: list[float], *, variance: bool) -> float:
    if not residue:
        return 0.0
    if not variance:
        return max(residue) - min(residue)
    mean = sum(residue) / len(residue)
    return sum((x - mean) ** 2 for x in residue) / len(residue)


def linear(arrays: Arrays, placed: Placed) -> float:
    """Return the linear costs: of moving, and of the problem's cost matrix."""
    if not arrays.cost:
        return 0.0
    return sum(
        arrays.cost[unit * arrays.m + computer]
        for unit, computer in enumerate(placed)
        if computer >= 0
    )


def shortage(arrays: Arrays, load: list[float]) -> float:
    """Return what is used beyond soft limits, at their prices."""
    r = arrays.r
    return sum(
        price * max(0.0, used - limit)
        for k, price in enumerate(arrays.price)
        for used, limit in zip(load[k::r], arrays.limit[k::r], strict=True)
        if price > 0
    )
