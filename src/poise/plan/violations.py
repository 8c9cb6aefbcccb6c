"""Which limits a placement breaks, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from poise.model.hardware import fits
from poise.plan.problem.arrays import Arrays, Placed
from poise.plan.result_records import Shortage, Tightest
from poise.plan.summed_times import parts, seconds
from poise.units import format_bandwidth, format_bytes, format_seconds

KIBIBYTE, MILLION = 1024, 1e6
MOST_NAMED = 12


def named(names: Sequence[str]) -> str:
    """Return names for people, shortened where they are many."""
    more = len(names) - MOST_NAMED
    said = ", ".join(names[:MOST_NAMED])
    return f"{said} and {more} more" if more > 1 else ", ".join(names)


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
        *_scattered(arrays, placed),
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
            choices = " or ".join(map(arrays.computer, computers))
            may = f"may only run on {choices}" if choices else "can run nowhere"
            reasons = (arrays.problem.components[i].why for i in arrays.members[unit])
            why = next((f" ({reason})" for reason in reasons if reason), "")
            here = arrays.computer(placed[unit])
            yield f"{arrays.name(unit)} is on {here}, {may}{why}"


def _crowded(arrays: Arrays, placed: Placed) -> Iterator[str]:
    for i, j in arrays.apart:
        if placed[i] >= 0 and (i == j or placed[i] == placed[j]):
            names = f"{arrays.name(i)} and {arrays.name(j)}"
            if device := _shared_device(arrays, {i, j}):
                yield f"{names} use device {device}, which is exclusive"
            else:
                yield f"{names} must be apart, both are on {arrays.computer(placed[i])}"


def _shared_device(arrays: Arrays, units: set[int]) -> str | None:
    """Return an exclusive device that all of the units use."""
    for device, names in arrays.problem.exclusive.items():
        if units <= {arrays.unit_of[arrays.index[name]] for name in names}:
            return device
    return None


def _scattered(arrays: Arrays, placed: Placed) -> Iterator[str]:
    for group in arrays.problem.together:
        at = {name: placed[arrays.unit_of[arrays.index[name]]] for name in group}
        if len({*at.values()} - {-1}) > 1:
            where = (f"{n} is on {arrays.computer(h)}" for n, h in at.items() if h >= 0)
            yield f"{', '.join(group)} must share a computer: {', '.join(where)}"


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
