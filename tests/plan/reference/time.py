"""How long things take on a placement: the specification (docs/design/objective.md).

time(x) = fixed + sum over runs of seconds / speed(h) * slowdown(h)
        + sum over hops apart of seconds + crossings * latency + size / bandwidth

where slowdown(h) = 1 + u^k / (m (1 - u)), m cores being shared with others that use the
share u of them, and k = floor(sqrt(2 (m + 1)) - 1), but at least 1. Beyond u = 0.9 it
goes on as its tangent there. It is 1 where runs do not share, or there is no CPU.
"""

from __future__ import annotations

from math import floor, inf, sqrt

from poise.model.robot import Computer
from poise.plan import TimeLimit
from poise.plan.problem.arrays import Arrays, Placed

LEAST = 1e-30
"""A link with a bandwidth of 0 carries so much."""


def cost(arrays: Arrays, placed: Placed) -> float:
    """Return what is beyond time limits, as a share of them, at their prices."""
    return sum(
        each.price * max(0.0, takes(arrays, placed, each) / each.limit - 1)
        for each in arrays.problem.time_limits
    )


def is_late(arrays: Arrays, placed: Placed) -> bool:
    """Whether a time limit is broken that must be kept, wherever other units go."""
    return any(
        takes(arrays, placed, each) > each.limit + 1e-9 * max(1.0, each.limit)
        for each in arrays.problem.time_limits
        if each.price == 0
    )


def takes(arrays: Arrays, placed: Placed, limit: TimeLimit) -> float:
    """Return how long it takes [s].

    What has no computer (-1) runs on the fastest where it may, on its own; and its hops
    take nothing.
    """
    problem = arrays.problem
    where = {
        c.name: placed[unit]
        for c, unit in zip(problem.components, arrays.unit_of, strict=True)
    }
    total = limit.fixed
    for run in limit.runs:
        if (h := where[run.component]) >= 0:
            slow = slowdown(arrays, where, h, run.component) if limit.shared else 1.0
            total += run.seconds / problem.computers[h].speed * slow
        else:
            unit = arrays.unit_of[arrays.index[run.component]]
            may = arrays.allowed.get(unit) or range(arrays.m)
            total += run.seconds / max(problem.computers[g].speed for g in may)
    for hop in limit.hops:
        a, b = (where[name] for name in hop.between)
        if -1 in {a, b} or a == b:
            continue
        ends = {problem.computers[a].name, problem.computers[b].name}
        links = [link for link in problem.links if {*link.between} == ends]
        latency = max((link.latency for link in links), default=0.0)
        bandwidth = min((link.bandwidth for link in links), default=inf)
        total += hop.seconds + hop.crossings * latency
        total += hop.size / max(bandwidth, LEAST)
    return total


def slowdown(arrays: Arrays, where: dict[str, int], h: int, mine: str) -> float:
    """Return how many times as long a run of component `mine` takes on a computer."""
    computer = arrays.problem.computers[h]
    has = computer.total("cpu")
    if has <= 0:
        return 1.0
    others = sum(
        c.demand.get("cpu", 0.0)
        for c in arrays.problem.components
        if where[c.name] == h and c.name != mine
    )
    return formula(computer, others / has)


def formula(computer: Computer, u: float) -> float:
    """Return the slowdown where others use the share `u` of the CPU."""
    m = max(1, floor(computer.capacity["cpu"]))
    k = max(1, floor(sqrt(2 * (m + 1)) - 1))
    if u <= 0.9:
        return 1 + u**k / (m * (1 - u))
    top = 1 + 0.9**k / (m * 0.1)
    slope = (k * 0.9 ** (k - 1) * 0.1 + 0.9**k) / (m * 0.1**2)
    return top + slope * (u - 0.9)
