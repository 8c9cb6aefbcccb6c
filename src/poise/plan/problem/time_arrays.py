"""Time limits in flat arrays of numbers: what the C++ core reads of them."""

from __future__ import annotations

from collections.abc import Mapping
from math import isqrt

from msgspec import Struct

from poise.model.robot import Computer
from poise.plan.problem.problem import LEAST, Problem

MOST_CORES = 1024
"""More cores count as 1024: with as many, runs never wait for long."""

RunArray = tuple[int, float]
"""Component, and the seconds of its run."""
HopArray = tuple[int, int, float, float, float]
"""Its two components, seconds, crossings and size."""
LimitArray = tuple[float, float, float, int, list[RunArray], list[HopArray]]
"""Limit, price, fixed, the resource that runs share (-1: none), runs and hops."""


class Times(Struct, frozen=True):
    """The time limits of a problem on m computers."""

    limits: list[LimitArray]  # in the order of the problem
    speed: list[float]  # (m,): how fast a core is
    # cores, power: (m,): how many cores a computer has, and the power in the formula of
    # how long runs wait for one (docs/design/objective.md)
    cores: list[int]
    power: list[int]
    latency: list[float]  # (m, m), or empty: 0 [s]
    per_byte: list[float]  # (m, m), or empty: 0; how long a byte takes [s]


def times_of(problem: Problem, index: Mapping[str, int]) -> Times | None:
    """Return the time limits in numbers; None when there are none.

    `index` is the place of each component, by name.
    """
    if not problem.time_limits:
        return None
    resources = problem.resources
    cpu = resources.index("cpu") if "cpu" in resources else -1
    limits: list[LimitArray] = []
    for each in problem.time_limits:
        runs = [(index[run.component], run.seconds) for run in each.runs]
        hops = [
            (index[a], index[b], hop.seconds, hop.crossings, hop.size)
            for hop in each.hops
            for a, b in [hop.between]
        ]
        shares = cpu if each.shared else -1
        limits.append((each.limit, each.price, each.fixed, shares, runs, hops))
    queues = [queue_of(h) for h in problem.computers]
    return Times(
        limits,
        [h.speed for h in problem.computers],
        [cores for cores, _ in queues],
        [power for _, power in queues],
        *_links(problem),
    )


def queue_of(computer: Computer) -> tuple[int, int]:
    """Return how many cores runs wait for, and the power in the formula of that."""
    cores = max(1, int(min(computer.capacity.get("cpu", 0.0), MOST_CORES)))
    return cores, max(1, isqrt(2 * (cores + 1)) - 1)


def _links(problem: Problem) -> tuple[list[float], list[float]]:
    """Return latency and seconds per byte: of several links those of the worst."""
    place = {h.name: i for i, h in enumerate(problem.computers)}
    m = len(place)
    latency, per_byte = [0.0] * (m * m), [0.0] * (m * m)
    for link in problem.links:
        a, b = (place[name] for name in link.between)
        slow = 1 / max(link.bandwidth, LEAST)
        for pair in (a * m + b, b * m + a):
            latency[pair] = max(latency[pair], link.latency)
            per_byte[pair] = max(per_byte[pair], slow)
    return latency if any(latency) else [], per_byte if any(per_byte) else []
