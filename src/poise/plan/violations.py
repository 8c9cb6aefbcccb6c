"""Which limits a placement breaks, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from poise.model.hardware import fits
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
from poise.plan.result_records import Shortage, Tightest
from poise.units import format_bandwidth, format_bytes, format_seconds

BUSIEST = 0.9
"""Up to which use the formula of waiting holds; beyond, its tangent there goes on."""


class Part(NamedTuple):
    """A run (of one component) or a hop (between two): what it takes, and where.

    Where a component has no computer (-1) its run takes what it takes at least.
    """

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


KIBIBYTE, MILLION = 1024, 1e6


def amount_of(resource: str, amount: float) -> str:
    """Return an amount for people, in the resource's unit where that is known."""
    if resource == "bandwidth":
        return format_bandwidth(amount)
    if resource == "memory" and amount >= KIBIBYTE:
        return format_bytes(amount)
    return f"{amount:.6g}" if amount < MILLION else f"{amount:,.0f}"


class Late(NamedTuple):
    """A time limit that is broken: what it takes [s], and all of it for people."""

    seconds: float
    text: str


def loads(arrays: Arrays, placed: Placed) -> list[float]:
    """Return what is used, (m, r)."""
    r = arrays.r
    total = [0.0] * (arrays.m * r)
    for unit, computer in enumerate(placed):
        if computer >= 0:
            for k in range(r):
                total[computer * r + k] += arrays.demand[unit * r + k]
    return total


def traffic(arrays: Arrays, placed: Placed) -> dict[tuple[int, int], float]:
    """Return the traffic [bytes/s] between every pair of computers that has any."""
    total: dict[tuple[int, int], float] = {}
    for i, j, _, sent in arrays.connectors:
        a, b = sorted((placed[i], placed[j]))
        if 0 <= a < b and sent > 0:
            total[a, b] = total.get((a, b), 0.0) + sent
    return total


def violations(arrays: Arrays, placed: Placed) -> list[str]:
    """Return every limit that a placement breaks; some units may have no computer."""
    times = late(arrays, placed).values()
    return [*_in_place(arrays, placed), *(broken.text for broken in times)]


def _in_place(arrays: Arrays, placed: Placed) -> list[str]:
    """Return every limit that is broken but those of time."""
    return [
        *_overfull(arrays, placed),
        *_misplaced(arrays, placed),
        *_crowded(arrays, placed),
        *_overloaded(arrays, placed),
    ]


def obstacle(arrays: Arrays, placed: Placed, unit: int, computer: int) -> str:
    """Return which limits break when a unit without a computer joins one, or ''."""
    trial = [*placed[:unit], computer, *placed[unit + 1 :]]
    before, was = _in_place(arrays, placed), late(arrays, placed)
    broken = [limit for limit in _in_place(arrays, trial) if limit not in before]
    for name, limit in late(arrays, trial).items():
        if name not in was or not fits(limit.seconds, was[name].seconds):
            broken.append(limit.text)
    return "; ".join(broken)


def _overfull(arrays: Arrays, placed: Placed) -> Iterator[str]:
    load = loads(arrays, placed)
    for h, computer in enumerate(arrays.problem.computers):
        for k, resource in enumerate(arrays.resources):  # soft limits come after them
            used, limit = load[h * arrays.r + k], arrays.limit[h * arrays.r + k]
            if used > 0 and not fits(used, limit):
                needs, has = amount_of(resource, used), amount_of(resource, limit)
                short = amount_of(resource, used - limit)
                where = f"{computer.name}: {resource}"
                yield f"{where} needs {needs}, has {has}: {short} short"


def _misplaced(arrays: Arrays, placed: Placed) -> Iterator[str]:
    for unit, computers in arrays.allowed.items():
        if placed[unit] >= 0 and placed[unit] not in computers:
            choices = " or ".join(map(arrays.computer, computers)) or "no computer"
            reasons = (arrays.problem.components[i].why for i in arrays.members[unit])
            why = next((f" ({reason})" for reason in reasons if reason), "")
            here = arrays.computer(placed[unit])
            yield f"{arrays.name(unit)} is on {here}, may only run on {choices}{why}"


def _crowded(arrays: Arrays, placed: Placed) -> Iterator[str]:
    for i, j in arrays.apart:
        if placed[i] >= 0 and (i == j or placed[i] == placed[j]):
            names = f"{arrays.name(i)} and {arrays.name(j)}"
            yield f"{names} must be apart, both are on {arrays.computer(placed[i])}"


def _overloaded(arrays: Arrays, placed: Placed) -> Iterator[str]:
    if not arrays.bandwidth:
        return
    for (a, b), used in sorted(traffic(arrays, placed).items()):
        limit = arrays.bandwidth[a * arrays.m + b]
        if not fits(used, limit):
            needs, has = (amount_of("bandwidth", x) for x in (used, limit))
            names = f"{arrays.computer(a)} and {arrays.computer(b)}"
            yield f"link between {names}: needs {needs}, has {has}"


def late(arrays: Arrays, placed: Placed) -> dict[str, Late]:
    """Return the time limits that are broken and must be kept, by name."""
    load = loads(arrays, placed) if arrays.times is not None else []
    broken: dict[str, Late] = {}
    for i, takes in enumerate(seconds(arrays, placed, load)):
        limit = arrays.problem.time_limits[i]
        if limit.price > 0 or fits(takes, limit.limit):
            continue
        needs = "takes at least" if -1 in placed else "takes"
        broken[limit.name] = Late(
            takes,
            f"time limit {limit.name!r}: {needs} {format_seconds(takes)}, "
            f"limit {format_seconds(limit.limit)}{_most(arrays, placed, load, i)}",
        )
    return broken


def _most(arrays: Arrays, placed: Placed, load: list[float], limit: int) -> str:
    """Return which run or hop takes most, for people; where there are several."""
    some = list(parts(arrays, placed, load, limit))
    if len(some) < 2:  # noqa: PLR2004 - one is all
        return ""
    most = max(some, key=lambda part: part.seconds)
    names = [arrays.problem.components[c].name for c in most.components]
    where = [arrays.computer(h) for h in most.computers if h >= 0]
    what = " to ".join(names) + (f" on {' and '.join(where)}" if where else "")
    return f" (most of it: {what}, {format_seconds(most.seconds)})"


def shortages(arrays: Arrays, placed: Placed) -> Iterator[Shortage]:
    """Yield by how much resources with soft limits are beyond what is usable."""
    soft = {limit.resource for limit in arrays.problem.soft_limits}
    load = loads(arrays, placed) if soft else []
    for h, computer in enumerate(arrays.problem.computers if soft else ()):
        for k, resource in enumerate(arrays.resources):
            used, limit = load[h * arrays.r + k], computer.usable(resource)
            if resource in soft and used > 0 and not fits(used, limit):
                yield Shortage(
                    computer=computer.name, resource=resource, amount=used - limit
                )


def tightest(arrays: Arrays, placed: Placed) -> Tightest | None:
    """Return the resource whose use is closest to its limit, or None without any."""
    load = loads(arrays, placed)
    shares = [
        Tightest(
            computer=computer.name,
            resource=resource,
            used=load[h * arrays.r + k] / computer.usable(resource),
        )
        for h, computer in enumerate(arrays.problem.computers)
        for k, resource in enumerate(arrays.resources)
        if computer.usable(resource) > 0
    ]
    return max(shares, key=lambda share: share.used, default=None)
