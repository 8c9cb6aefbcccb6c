"""A problem changed in one way: fewer components, other computers, CPU that is shared.

Where something is left out, overhead counts for as much as in the whole.

CPU can be shared: what gets less of it does less. Memory and devices cannot, so their
limits stay hard. Where components of several priorities share a computer, the higher
ones get what they need first; so the shortage of a priority is what it and all above it
need together beyond what there is, less that of those above alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from msgspec.structs import replace

from poise.errors import UsageError, unknown
from poise.model.robot import Computer, Link
from poise.model.software import importance
from poise.plan.problem.arrays import Arrays, arrays_of, overhead_scale
from poise.plan.problem.items import Item, SoftLimit
from poise.plan.problem.problem import Problem


def keep_components(
    problem: Problem, names: Collection[str], *, arrays: Arrays | None = None
) -> Problem:
    """Return the problem with only the components called `names`.

    Of the time limits, those that others have a part in are left out.

    Parameters
    ----------
    arrays
        The numbers of the problem, where they are there already.
    """
    if all(c.name in names for c in problem.components):
        return problem

    def group(members: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for name in members if name in names)

    return replace(
        problem,
        components=tuple(c for c in problem.components if c.name in names),
        connectors=tuple(
            k for k in problem.connectors if all(end in names for end in k.between)
        ),
        together=tuple(group(members) for members in problem.together),
        apart=tuple(group(members) for members in problem.apart),
        exclusive={name: group(users) for name, users in problem.exclusive.items()},
        architectures=tuple(
            a for a in problem.architectures if all(n in names for n in a.components)
        ),
        soft_limits=tuple(
            limit
            if limit.components is None
            else replace(limit, components=group(limit.components))
            for limit in problem.soft_limits
        ),
        time_limits=tuple(
            limit
            for limit in problem.time_limits
            if all(name in names for name in limit.components)
        ),
        overhead_scale=scale_of(problem, arrays),
    )


def scale_of(problem: Problem, arrays: Arrays | None = None) -> float | None:
    """Return the overhead scale that parts of a problem take over."""
    if problem.overhead_scale is not None or problem.objective.scale == "paper":
        return problem.overhead_scale
    arrays = arrays or arrays_of(problem)
    return overhead_scale(problem, arrays.overhead, arrays.traffic)


def without(
    problem: Problem, names: Collection[str], *, fewer: bool = False
) -> Problem:
    """Return the problem without the computers called `names`.

    An architecture that may run on no other is left out where an alternative may.

    Parameters
    ----------
    fewer
        Other components that may run on no other are stranded, unless an architecture
        with them is required.

    Raises
    ------
    UsageError
        When there is no such computer, or a component may run on no other.
    """
    known = [h.name for h in problem.computers]
    for name in names:
        if name not in known:
            raise UsageError(unknown("computer", name, known))
    problem = _without_stranded(problem, names)
    stranded = _stranded(problem, names)
    if fewer:
        optional = {n for a in problem.architectures for n in a.components}
        for a in problem.architectures:
            if a.required:
                optional.difference_update(a.components)
        stranded = [name for name in stranded if name not in optional]
    if stranded:
        raise UsageError(
            f"without {', '.join(sorted(names))}, these can run nowhere: "
            f"{', '.join(stranded)}"
        )
    return replace(
        problem,
        components=tuple(_without(c, names) for c in problem.components),
        computers=tuple(h for h in problem.computers if h.name not in names),
        links=tuple(
            link
            for link in problem.links
            if not any(name in names for name in link.between)
        ),
        soft_limits=tuple(
            replace(s, limits={h: x for h, x in s.limits.items() if h not in names})
            for s in problem.soft_limits
        ),
        overhead_scale=scale_of(problem),
    )


def add(problem: Problem, computer: Computer) -> Problem:
    """Return the problem with one more computer, at distance 1 from all others.

    Raises
    ------
    UsageError
        When there is a computer of that name.
    """
    if any(h.name == computer.name for h in problem.computers):
        raise UsageError(f"there is a computer called {computer.name!r} already")
    return replace(problem, computers=(*problem.computers, computer))


def scale(problem: Problem, factors: Mapping[str, float]) -> Problem:
    """Return the problem with capacities multiplied.

    Each key of `factors` is a computer (all its capacities) or a resource (of every
    computer), in any case of letters where none is spelt like it; each value is finite
    and >= 0.

    Raises
    ------
    UsageError
        When a name is neither, or two mean the same.
    """
    known = dict.fromkeys([*(h.name for h in problem.computers), *problem.resources])
    by: dict[str, str] = {}  # a computer or resource -> the key that means it
    for name in factors:
        alike = [k for k in known if k.lower() == name.lower()]
        meant = [name] if name in known else alike
        if not meant:
            raise UsageError(
                f"{name!r} is neither a computer nor a resource ({', '.join(known)})"
            )
        for each in meant:
            if (other := by.setdefault(each, name)) != name:
                raise UsageError(f"{other!r} and {name!r} mean the same: scale it once")
    factor = {name: factors[key] for name, key in by.items()}
    return replace(
        problem,
        computers=tuple(
            replace(
                h,
                capacity={
                    r: amount * factor.get(r, 1.0) * factor.get(h.name, 1.0)
                    for r, amount in h.capacity.items()
                },
            )
            for h in problem.computers
        ),
    )


def _stranded(problem: Problem, names: Collection[str]) -> list[str]:
    """Return the components that may run only on computers called `names`."""
    return [c.name for c in problem.components if c.only and {*c.only} <= {*names}]


def _without_stranded(problem: Problem, names: Collection[str]) -> Problem:
    """Return the problem without architectures that are stranded, where others run."""
    stranded = _stranded(problem, names)
    able = [a for a in problem.architectures if not {*a.components} & {*stranded}]
    served = {a.function for a in able if a.function}
    gone = [a for a in problem.architectures if a.function in served and a not in able]
    others = [a for a in problem.architectures if a not in gone]
    dropped = {name for a in gone for name in a.components}
    dropped.difference_update(*(a.components for a in others))
    return keep_components(problem, {c.name for c in problem.components} - dropped)


def _without(component: Item, names: Collection[str]) -> Item:
    only = tuple(h for h in component.only if h not in names)
    stranded = component.stranded or bool(component.only and not only)
    why = component.why or f"only {' or '.join(component.only)}" if stranded else ""
    present = None if component.present in names else component.present
    cost = {h: x for h, x in component.cost.items() if h not in names}
    return replace(
        component,
        only=only,
        stranded=stranded,
        present=present,
        cost=cost,
        why=why or component.why,
    )


PRICE = 1000.0
"""What F grows by for each core that is short, of the lowest priority: far more than
all other terms come to with the weights that a robot has by default."""
_LARGEST = 1e12
"""What other terms are taken to come to at most."""
_RESERVE = 0.01
"""What a core of the reserve costs that is used, as a share of one that is short."""


class Margin(NamedTuple):
    """What placements leave free where they can.

    Parameters
    ----------
    limits
        Computer -> how much may be used beside it [cores]; where not named, what the
        computer can use beside its reserve.
    share
        What a core beyond that costs, as a share of one that is short.
    """

    limits: Mapping[str, float]
    share: float


def share_cpu(
    problem: Problem,
    price: float | None = None,
    limits: Mapping[str, float] | None = None,
    margins: Sequence[Margin] = (Margin({}, _RESERVE),),
) -> Problem:
    """Return the problem with CPU that is shared where it is short.

    Parameters
    ----------
    price
        What F grows by for each core that is short, of the lowest priority; > 0. None:
        `PRICE`, or more where the weights are such that other terms come to more.
    limits
        Computer -> what there is [cores]; all that it has, where not named.
    margins
        What is left free besides, where possible.
    """
    price = PRICE * _others(problem) if price is None else price
    has = {h.name: h.total("cpu") for h in problem.computers} | {**(limits or {})}
    priority = dict.fromkeys((c.name for c in problem.components), _lowest(problem))
    for bundle in problem.architectures:
        for name in bundle.components:
            priority[name] = max(priority[name], bundle.priority)
    counts = importance(priority.values())
    steps = pairwise([0.0, *counts.values()])
    work = [
        SoftLimit(
            resource="cpu",
            price=price * (more - less),
            limits=has,
            components=tuple(name for name, p in priority.items() if p >= least),
        )
        for least, (less, more) in zip(counts, steps, strict=False)
    ]
    left = [
        SoftLimit(resource="cpu", price=price * share, limits=most)
        for most, share in margins
        if share > 0
    ]
    others = [limit for limit in problem.soft_limits if limit.resource != "cpu"]
    return replace(problem, soft_limits=(*others, *work, *left))


def with_small_terms(problem: Problem, *, without: Collection[Link] = ()) -> Problem:
    """Return the problem with weights such that F comes to about 1 at most.

    A price of something else then means the same for all robots.
    `without`: links that count as if they were not there.
    """
    links = tuple(link for link in problem.links if link not in without)
    others, weights = _others(replace(problem, links=links)), problem.objective
    smaller = replace(
        weights,
        communication=weights.communication / others,
        balance=weights.balance / others,
        quality=weights.quality / others,
    )
    return replace(problem, objective=smaller)


def _others(problem: Problem) -> float:
    """Return about what a term of F comes to at most, beside CPU; at least 1."""
    arrays = arrays_of(problem)
    apart = sum(overhead for _, _, overhead, _ in arrays.connectors)
    most = arrays.communication * apart * max(arrays.distance, default=1.0)
    for k, weight in enumerate(arrays.spread):
        has = max(arrays.capacity[k :: arrays.r], default=0.0)
        spread = 1.0 if arrays.share else has
        most += weight * (spread * spread if arrays.variance else spread)
    return min(max(1.0, most, problem.objective.quality), _LARGEST)


def _lowest(problem: Problem) -> int:
    return min((bundle.priority for bundle in problem.architectures), default=0)
