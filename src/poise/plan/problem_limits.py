"""The limits of a problem, in words, and the problem with some of them relaxed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf
from typing import NamedTuple

from msgspec.structs import replace

from poise.model.robot import Computer, Objective
from poise.plan.problem.items import SoftLimit
from poise.plan.problem.problem import LEAST, MOST, Problem
from poise.plan.result_records import More
from poise.plan.summed_times import longest
from poise.plan.violations import amount_of
from poise.units import format_seconds


class Limit(NamedTuple):
    """A limit of a problem, in words.

    `names` are a computer and its resource (kind ``capacity``), the two ends of a
    ``link``, a limit of ``time``, the components that are to be ``together``,
    ``apart`` or on certain computers ``only``, or a device that is ``exclusive`` and
    the components that use it. The first three kinds can be raised, from `now` on; by
    `most`, they limit nothing any more. `advice` is what to do about the others.
    """

    kind: str
    names: tuple[str, ...]
    text: str
    advice: str = ""
    now: float = 0.0
    most: float = 0.0

    def covers(self, other: Limit) -> bool:
        """Whether it is `other`, or limits that and more."""
        return self.kind == other.kind and {*self.names} >= {*other.names}


Raises = Mapping[Limit, float]
"""By how much limits are raised, in their own units; infinite: lifted altogether."""


def relaxed(problem: Problem, raises: Raises) -> Problem:
    """Return the problem with some of its limits raised or lifted."""
    more = {(k.kind, *k.names): min(x, k.most or inf) for k, x in raises.items()}
    turns = [u for d, u in problem.exclusive.items() if ("exclusive", d, *u) in more]
    components = {c.name: c for c in problem.components}
    left = dict(components)
    for users in turns:
        # one after the other: as much as one of them needs at most. Who also uses
        # another device runs beside others of its users, and counts with the first
        some = [left.pop(user) for user in users if user in left]
        most = dict(sorted(amount for c in some for amount in c.demand.items()))
        for c in some:
            components[c.name] = replace(c, demand=most)
            most = {}
    return replace(
        problem,
        components=tuple(
            replace(c, only=(), stranded=False) if ("only", c.name) in more else c
            for c in components.values()
        ),
        computers=tuple(
            replace(
                h,
                capacity={
                    **h.capacity,
                    **{
                        names[1]: _in_range(h.capacity.get(names[1], 0.0) + x)
                        for (kind, *names), x in more.items()
                        if (kind, names[0]) == ("capacity", h.name)
                    },
                },
            )
            for h in problem.computers
        ),
        links=tuple(
            replace(k, bandwidth=_in_range(k.bandwidth + x))
            if (x := more.get(("link", *k.between)))
            else k
            for k in problem.links
        ),
        together=(
            *(g for g in problem.together if ("together", *g) not in more),
            *turns,
        ),
        apart=tuple(g for g in problem.apart if ("apart", *g) not in more),
        exclusive={
            device: users
            for device, users in problem.exclusive.items()
            if ("exclusive", device, *users) not in more
        },
        time_limits=tuple(
            replace(t, limit=_in_range(t.limit + x))
            if (x := more.get(("time", t.name)))
            else t
            for t in problem.time_limits
        ),
    )


def _in_range(amount: float) -> float:
    """Return an amount above 0 that a problem may have: it may be raised by any."""
    return min(max(amount, LEAST), MOST)


def softened(problem: Problem, capacities: list[Limit]) -> Problem:
    """Return the problem whose F is the rise of capacities, as shares of usual."""
    soft = list(problem.soft_limits)
    for limit in capacities:
        (computer, resource) = limit.names
        share = next(
            share_of(h, resource) for h in problem.computers if h.name == computer
        )
        others = {h.name: MOST for h in problem.computers if h.name != computer}
        price = _in_range(1 / usual(problem, limit) / share)
        soft.append(SoftLimit(resource=resource, limits=others, price=price))
    return replace(
        problem,
        objective=Objective(communication=0.0, balance=0.0),
        soft_limits=tuple(soft),
    )


def in_words(raises: Raises) -> str:
    """Return what has to give way, for people."""
    amounts = (
        _raise(more, limit) for more, limit in zip(rises(raises), raises, strict=False)
    )
    return " and ".join([*amounts, *(limit.advice for limit in raises if limit.advice)])


def _raise(more: More, limit: Limit) -> str:
    where = " - ".join(more.on)
    if limit.kind == "time":
        amount, now = format_seconds(more.amount), format_seconds(limit.now)
        return f"{amount} more for time limit {where!r} ({now} now)"
    amount, now = (amount_of(more.resource, x) for x in (more.amount, limit.now))
    return f"{amount} more {more.resource} on {where} ({now} now)"


def rises(raises: Raises) -> tuple[More, ...]:
    """Return the raises as plain records."""
    resource = {"link": "bandwidth", "time": "time"}
    return tuple(
        More(on=limit.names, resource=resource[limit.kind], amount=amount)
        if limit.kind in resource
        else More(on=limit.names[:1], resource=limit.names[1], amount=amount)
        for limit, amount in raises.items()
        if not limit.advice
    )


def price(problem: Problem, raises: Raises) -> float:
    """Return the sum of raises, each as a share of what is `usual`."""
    if not raises or any(limit.advice for limit in raises):
        return inf
    return sum(more / usual(problem, limit) for limit, more in raises.items())


def usual(problem: Problem, limit: Limit) -> float:
    """Return what the largest limit of this kind is, to measure a raise by."""
    if limit.kind in {"link", "time"}:
        return limit.now or 1.0
    return max(h.capacity.get(limit.names[1], 0.0) for h in problem.computers) or 1.0


_IDLE = 100.0
"""More CPU than this multiple of all demands makes nothing quicker that shares it."""


def limits_of(problem: Problem) -> Iterator[Limit]:
    """Yield each limit of a problem."""
    softened = {limit.resource for limit in problem.soft_limits}
    is_shared = any(t.shared and not t.price for t in problem.time_limits)
    for resource in (r for r in problem.resources if r not in softened):
        total = sum(c.demand.get(resource, 0.0) for c in problem.components)
        if total > 0:
            room = _IDLE if is_shared and resource == "cpu" else 1.0
            for h in problem.computers:
                yield _capacity(h, resource, room * total)
    traffic = sum(k.traffic for k in problem.connectors)
    if traffic > 0:
        for link in (k for k in problem.links if k.bandwidth < inf):
            carries = amount_of("bandwidth", link.bandwidth)
            text = f"link {' - '.join(link.between)} carries {carries}"
            yield Limit("link", link.between, text, now=link.bandwidth, most=traffic)
    for t in problem.time_limits:
        if not t.price:
            text = f"time limit {t.name!r} is {format_seconds(t.limit)}"
            most = longest(problem, t) * (2.0 if t.shared else 1.0)
            yield Limit("time", (t.name,), text, now=t.limit, most=most)
    yield from _groups("together", problem.together, "run apart")
    yield from _groups("apart", problem.apart, "share a computer")
    yield from _exclusive(problem)
    for c in problem.components:
        if c.only or c.stranded:
            why = f" ({c.why})" if c.why else ""
            may = f"may only run on {' or '.join(c.only)}"
            text = f"{c.name} {'can run nowhere' if c.stranded else may}{why}"
            yield Limit("only", (c.name,), text, f"letting {c.name} run elsewhere")


def _groups(
    kind: str, groups: tuple[tuple[str, ...], ...], advice: str
) -> Iterator[Limit]:
    for group in groups:
        if len(group) > 1:
            text, names = f"{kind}: {', '.join(group)}", " and ".join(group)
            yield Limit(kind, group, text, f"letting {names} {advice}")


def _exclusive(problem: Problem) -> Iterator[Limit]:
    for device, users in problem.exclusive.items():
        if len(users) > 1:
            text = f"{', '.join(users)} use device {device}, which is exclusive"
            advice = f"{' and '.join(users)} running one after the other"
            yield Limit("exclusive", (device, *users), text, advice)


def _capacity(h: Computer, resource: str, total: float) -> Limit:
    has, share = h.capacity.get(resource, 0.0), share_of(h, resource)
    usable = f" ({amount_of(resource, has * share)} usable)" if share != 1 else ""
    text = f"{h.name} has {amount_of(resource, has)} {resource}{usable}"
    return Limit("capacity", (h.name, resource), text, now=has, most=total / share)


def share_of(h: Computer, resource: str) -> float:
    """Return how much of a unit of capacity can be used."""
    return (h.speed if resource == "cpu" else 1.0) * (1 - h.reserve.get(resource, 0.0))
