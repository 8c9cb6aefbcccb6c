"""How long what has a time limit takes on a placement, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from poise.model.hardware import fits
from poise.plan.problem.arrays import Arrays, Placed
from poise.plan.problem.time_arrays import HopArray, RunArray, Times
from poise.units import format_seconds

BUSIEST = 0.9
"""Up to which use the formula of waiting holds; beyond, its tangent there goes on."""


class Part(NamedTuple):
    """A run (one component) or a hop (two): what it takes [s], and on which computers.

    Of a component without a computer the run takes what it takes at least.
    """

    seconds: float
    ends: tuple[int, ...]
    computers: tuple[int, ...]


def parts(
    arrays: Arrays, times: Times, placed: Placed, load: Sequence[float], limit: int
) -> Iterator[Part]:
    """Yield each run, and each hop whose ends are apart, of the time limit `limit`.

    `load` is what is used, (m, r). The ends of a run are a component, those of a hop
    two units.
    """
    _, _, _, cpu, runs, hops = times.limits[limit]
    for run in runs:
        h = placed[arrays.unit_of[run[0]]]
        yield Part(_run(arrays, times, h, load, cpu, run), (run[0],), (h,))
    for hop in hops:
        a, b = placed[hop[0]], placed[hop[1]]
        if a >= 0 and b >= 0 and a != b:
            yield Part(_hop(times, a * arrays.m + b, hop), hop[:2], (a, b))


def seconds(arrays: Arrays, placed: Placed, load: Sequence[float]) -> list[float]:
    """Return what each time limit is about takes [s].

    While units have no computer: what it takes at least.
    """
    times = arrays.times
    if times is None:
        return []
    return [
        limit[2] + sum(p.seconds for p in parts(arrays, times, placed, load, i))
        for i, limit in enumerate(times.limits)
    ]


def late(arrays: Arrays, placed: Placed, load: Sequence[float]) -> Iterator[str]:
    """Yield the time limits that a placement breaks, though they must be kept.

    While units have no computer: those that it will break wherever these go.
    """
    for i, takes in enumerate(seconds(arrays, placed, load)):
        limit = arrays.problem.time_limits[i]
        if limit.price > 0 or fits(takes, limit.limit):
            continue
        needs = "takes at least" if -1 in placed else "takes"
        yield (
            f"time limit {limit.name!r}: {needs} {format_seconds(takes)}, "
            f"limit {format_seconds(limit.limit)}{_most(arrays, placed, load, i)}"
        )


def _most(arrays: Arrays, placed: Placed, load: Sequence[float], limit: int) -> str:
    """Return which run or hop takes most, for people; where there are several."""
    assert arrays.times is not None  # noqa: S101 - it has this limit
    some = list(parts(arrays, arrays.times, placed, load, limit))
    if len(some) < 2:  # noqa: PLR2004 - one is all
        return ""
    most = max(some, key=lambda part: part.seconds)
    if len(most.ends) == 1:
        what = arrays.problem.components[most.ends[0]].name
        on = most.computers[0]
        what += f" on {arrays.computer(on)}" if on >= 0 else ""
    else:
        what = " to ".join(map(arrays.name, most.ends))
        what += f" over {' - '.join(map(arrays.computer, most.computers))}"
    return f" (most of it, {format_seconds(most.seconds)}: {what})"


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
