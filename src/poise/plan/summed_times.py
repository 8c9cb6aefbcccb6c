"""What a chain or a timer's run takes, by what can be summed: as `core/times.cpp`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from poise.plan.problem.arrays import (
    Arrays,
    HopArray,
    Placed,
    RunArray,
    Times,
    queue_of,
)
from poise.plan.problem.items import TimeLimit
from poise.plan.problem.problem import LEAST, Problem

BUSIEST = 0.9
"""Up to which use the formula of waiting holds; beyond, its tangent there goes on."""


class Part(NamedTuple):
    """A run of a component or a hop between two; without a computer (-1) at least."""

    seconds: float
    components: tuple[int, ...]
    computers: tuple[int, ...]


def parts(
    arrays: Arrays, placed: Placed, load: Sequence[float], limit: int
) -> Iterator[Part]:
    """Yield each run of a time limit, and each hop whose ends are apart."""
    times = arrays.times
    assert times is not None  # noqa: S101 - it has this limit
    _, _, _, cpu, runs, hops = times.limits[limit]
    for run in runs:
        h = placed[arrays.unit_of[run[0]]]
        yield Part(_run(arrays, times, h, load, cpu, run), (run[0],), (h,))
    for hop in hops:
        a, b = (placed[arrays.unit_of[end]] for end in hop[:2])
        if a >= 0 and b >= 0 and a != b:
            yield Part(_hop(times, a * arrays.m + b, hop), hop[:2], (a, b))


def seconds(arrays: Arrays, placed: Placed, load: Sequence[float]) -> list[float]:
    """Return how long what each time limit is about takes [s]."""
    return [
        limit[2] + sum(part.seconds for part in parts(arrays, placed, load, i))
        for i, limit in enumerate(arrays.times.limits if arrays.times else ())
    ]


def longest(problem: Problem, limit: TimeLimit) -> float:
    """Return what something takes no longer than, on any placement [s]."""
    demand = sum(c.demand.get("cpu", 0.0) for c in problem.components)
    runs = sum(run.seconds for run in limit.runs)
    slowest = 0.0
    for h in problem.computers:
        use = demand / has if limit.shared and (has := h.total("cpu")) > 0 else 0.0
        slowest = max(slowest, slowdown(use, *queue_of(h)) / h.speed)
    latency = max((link.latency for link in problem.links), default=0.0)
    per_byte = max((1 / max(k.bandwidth, LEAST) for k in problem.links), default=0.0)
    return (
        limit.fixed
        + runs * slowest
        + sum(k.seconds + k.crossings * latency + k.size * per_byte for k in limit.hops)
    )


def slowdown(use: float, cores: int, power: int) -> float:
    """Return how many times as long a run takes where others use a share of the CPU.

    Sakasegawa 1977, "An approximation formula L_q = alpha rho^beta / (1 - rho)"; from
    `BUSIEST` on its tangent.
    """
    u = min(max(use, 0.0), BUSIEST)
    waits = u**power / (cores * (1 - u))
    if use <= BUSIEST:
        return 1 + waits
    slope = (power / u + 1 / (1 - u)) * waits
    return 1 + waits + slope * (use - BUSIEST)


def _run(
    arrays: Arrays,
    times: Times,
    computer: int,
    load: Sequence[float],
    cpu: int,
    run: RunArray,
) -> float:
    component, needs = run
    if computer < 0:
        allowed = arrays.allowed.get(arrays.unit_of[component], range(arrays.m))
        return needs / max((times.speed[h] for h in allowed), default=1.0)
    takes = needs / times.speed[computer]
    at = computer * arrays.r + cpu
    if cpu < 0 or arrays.capacity[at] <= 0:
        return takes
    others = load[at] - arrays.component_demand[component * arrays.r + cpu]
    use = others / arrays.capacity[at]
    return takes * slowdown(use, times.cores[computer], times.power[computer])


def _hop(times: Times, link: int, hop: HopArray) -> float:
    _, _, takes, crossings, size = hop
    if times.latency:
        takes += crossings * times.latency[link]
    if times.per_byte:
        takes += size * times.per_byte[link]
    return takes
