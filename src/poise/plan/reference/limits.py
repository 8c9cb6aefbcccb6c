"""Which limits a placement breaks, and why a unit may not go to a computer."""

from __future__ import annotations

from collections.abc import Iterator

from poise.plan.records import Tightest
from poise.plan.tables import Placed, Tables, fits
from poise.units import format_bandwidth, format_bytes

KIBIBYTE, MILLION = 1024, 1e6


def amount_of(resource: str, amount: float) -> str:
    """Return an amount for people, in the resource's unit where that is known."""
    if resource == "bandwidth":
        return format_bandwidth(amount)
    if resource == "memory" and amount >= KIBIBYTE:
        return format_bytes(amount)
    return f"{amount:.6g}" if amount < MILLION else f"{amount:,.0f}"


def obstacle(
    tables: Tables,
    placed: Placed,
    load: list[float],
    unit: int,
    computer: int,
) -> str:
    """Return why `unit` may not join `computer` as things stand, or ''."""
    if computer not in tables.allowed.get(unit, (computer,)):
        names = [tables.problem.computers[h].name for h in tables.allowed[unit]]
        why = next((w for w in _reasons(tables, unit) if w), "")
        choices = " or ".join(names) or "no computer"
        return f"may only run on {choices}" + (f" ({why})" if why else "")
    for k, resource in enumerate(tables.resources):
        need = tables.demand[unit * tables.r + k]
        used, limit = (t[computer * tables.r + k] for t in (load, tables.limit))
        if need > 0 and not fits(used + need, limit):
            left = amount_of(resource, max(0.0, limit - used))
            return f"{resource}: needs {amount_of(resource, need)}, {left} left"
    for i, j in tables.apart:
        if unit in (i, j) and (i == j or placed[i + j - unit] == computer):
            other = tables.problem.components[tables.members[i + j - unit][0]].name
            return f"must be apart from {other!r}"
    return _full_link(tables, placed, unit, computer)


def _reasons(tables: Tables, unit: int) -> Iterator[str]:
    return (tables.problem.components[i].why for i in tables.members[unit])


def _full_link(tables: Tables, placed: Placed, unit: int, computer: int) -> str:
    if not tables.bandwidth:
        return ""
    trial = [*placed]
    trial[unit] = computer
    for (a, b), used in sorted(traffic(tables, trial).items()):
        limit = tables.bandwidth[a * tables.m + b]
        if computer in (a, b) and not fits(used, limit):
            return _too_much(tables, a, b, used, limit)
    return ""


def traffic(tables: Tables, placed: Placed) -> dict[tuple[int, int], float]:
    """Return the traffic [bytes/s] between every pair of computers that has any."""
    total: dict[tuple[int, int], float] = {}
    for i, j, sent in zip(tables.first, tables.second, tables.traffic, strict=True):
        a, b = sorted((placed[i], placed[j]))
        if 0 <= a < b and sent > 0:
            total[a, b] = total.get((a, b), 0.0) + sent
    return total


def violations(tables: Tables, placed: Placed, load: list[float]) -> list[str]:
    """Return every limit that a placement breaks, for people."""
    return [
        *_overfull(tables, load),
        *_misplaced(tables, placed),
        *_crowded(tables, placed),
        *_overloaded(tables, placed),
    ]


def _overfull(tables: Tables, load: list[float]) -> Iterator[str]:
    for h, computer in enumerate(tables.problem.computers):
        for k, resource in enumerate(tables.resources):
            used, limit = load[h * tables.r + k], tables.limit[h * tables.r + k]
            if used > 0 and not fits(used, limit):
                needs, has = amount_of(resource, used), amount_of(resource, limit)
                short = amount_of(resource, used - limit)
                where = f"{computer.name}: {resource}"
                yield f"{where} needs {needs}, has {has}: {short} short"


def _misplaced(tables: Tables, placed: Placed) -> Iterator[str]:
    for unit, computers in tables.allowed.items():
        if placed[unit] >= 0 and placed[unit] not in computers:
            names = "+".join(
                tables.problem.components[i].name for i in tables.members[unit]
            )
            choices = " or ".join(tables.problem.computers[h].name for h in computers)
            yield (
                f"{names} is on {tables.problem.computers[placed[unit]].name}, "
                f"may only run on {choices or 'no computer'}"
            )


def _crowded(tables: Tables, placed: Placed) -> Iterator[str]:
    for i, j in tables.apart:
        if placed[i] >= 0 and (i == j or placed[i] == placed[j]):
            names = (
                tables.problem.components[tables.members[u][0]].name for u in (i, j)
            )
            yield (
                f"{' and '.join(names)} must be apart, "
                f"both are on {tables.problem.computers[placed[i]].name}"
            )


def _overloaded(tables: Tables, placed: Placed) -> Iterator[str]:
    if not tables.bandwidth:
        return
    for (a, b), used in sorted(traffic(tables, placed).items()):
        limit = tables.bandwidth[a * tables.m + b]
        if not fits(used, limit):
            yield _too_much(tables, a, b, used, limit)


def _too_much(tables: Tables, a: int, b: int, used: float, limit: float) -> str:
    names = " and ".join(tables.problem.computers[h].name for h in (a, b))
    needs, has = (amount_of("bandwidth", x) for x in (used, limit))
    return f"link between {names}: needs {needs}, has {has}"


def tightest(tables: Tables, load: list[float]) -> Tightest | None:
    """Return the resource whose use is closest to its limit, or None without any."""
    shares = [
        (load[h * tables.r + k] / limit, h, k)
        for h in range(tables.m)
        for k in range(tables.r)
        if (limit := tables.limit[h * tables.r + k]) > 0
    ]
    if not shares:
        return None
    used, h, k = max(shares, key=lambda share: share[0])
    return Tightest(
        computer=tables.problem.computers[h].name,
        resource=tables.resources[k],
        used=used,
    )
