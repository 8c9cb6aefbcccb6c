"""The smallest relaxation of limits: which must give way, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import ceil, floor, inf, log10
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from poise.model.hardware import fits
from poise.model.robot import Computer, Objective
from poise.plan.problem.items import SoftLimit
from poise.plan.problem.problem import LEAST, MOST, Problem
from poise.plan.result_records import More
from poise.plan.summed_times import longest
from poise.plan.violations import amount_of
from poise.units import format_seconds

NEAR = 5e-3
"""How close a raise comes to the least that is enough, relative to it."""
SIMPLER = 0.95
"""Several limits are raised instead of one if they take less than this share of it."""
MOST_TRIES = 64
"""How many single limits are tried to be raised."""


class Asks(Protocol):
    """Says whether a problem can hold."""

    def ask(self, problem: Problem) -> bool | None:
        """Return whether some placement keeps all limits; None when not known."""

    def is_spent(self) -> bool:
        """Return whether it answers no more."""

    def least(self, problem: Problem) -> Mapping[str, str]:
        """Return a placement of least F, as far as that is found; empty: none is."""


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
    return replace(
        problem,
        components=tuple(
            replace(c, only=(), stranded=False) if ("only", c.name) in more else c
            for c in problem.components
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
        together=tuple(g for g in problem.together if ("together", *g) not in more),
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
            _share(h, resource) for h in problem.computers if h.name == computer
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


class Relaxation:
    """Looks for what must give way; `conflicts` names the limits that are broken."""

    def __init__(
        self,
        oracle: Asks,
        conflicts: Callable[[Problem], tuple[Problem, list[Limit], bool] | None],
    ) -> None:
        self._oracle = oracle
        self._conflicts = conflicts

    def find(self, problem: Problem, limits: list[Limit]) -> Raises:
        """Return what has to give way, so that the whole problem holds; or nothing."""
        whole = list(limits_of(problem))
        limits = [next(k for k in whole if k.covers(limit)) for limit in limits]
        ways: list[Raises] = [
            {limit: self._at_most(problem, limit, limit.most)}
            for limit in limits[:MOST_TRIES]
            if limit.most > 0 and self._holds(problem, {limit: inf})
        ]
        one = min(ways, key=lambda way: price(problem, way), default=None)
        several = self._capacities(problem) or self._several(problem, limits)
        if one is None or price(problem, several) < SIMPLER * price(problem, one):
            return several
        return one

    def _capacities(self, problem: Problem) -> Raises:
        """Return the least rises of capacities that are enough, if any are."""
        soft = [k for k in limits_of(problem) if k.kind == "capacity"]
        if len(soft) > MOST_TRIES or len(problem.components) > MOST_TRIES:
            return {}
        placement = self._oracle.least(softened(problem, soft))
        raises: dict[Limit, float] = {}
        for limit in soft if placement else ():
            computer, resource = limit.names
            h = next(h for h in problem.computers if h.name == computer)
            used = sum(
                c.demand.get(resource, 0.0)
                for c in problem.components
                if placement[c.name] == computer
            )
            if not fits(used, usable := h.usable(resource)):
                raises[limit] = (used - usable) / _share(h, resource)
        for limit, enough in list(raises.items()):
            others = {k: more for k, more in raises.items() if k is not limit}
            raises[limit] = self._at_most(relaxed(problem, others), limit, enough)
        return raises if self._holds(problem, raises) else {}

    def _several(self, problem: Problem, limits: list[Limit]) -> Raises:
        """Lift what is in conflict, over and over; then take back what was needless."""
        chosen: list[Limit] = []
        while not self._holds(problem, dict.fromkeys(chosen, inf)):
            lifted = [limit for limit in limits if limit.most > 0] or limits[-1:]
            if not lifted:
                return {}
            chosen += lifted
            conflicts = self._conflicts(relaxed(problem, dict.fromkeys(chosen, inf)))
            limits = [
                limit
                for limit in limits_of(problem)
                if conflicts and any(limit.covers(other) for other in conflicts[1])
                if limit not in chosen
            ]
        return self._with_less(problem, chosen)

    def _with_less(self, problem: Problem, chosen: list[Limit]) -> Raises:
        """Return a relaxation of some of these limits: none more than is needed."""
        for limit in [k for k in chosen if k.advice]:
            others = [other for other in chosen if other is not limit]
            if self._holds(problem, dict.fromkeys(others, inf)):
                chosen = others
        lifts: Raises = dict.fromkeys((k for k in chosen if k.advice), inf)
        soft = sorted((k for k in chosen if not k.advice), key=lambda k: k.names)
        if not soft or self._holds(problem, lifts):
            return lifts
        # All alike first, in shares of what is usual; then one by one.
        units = {k: usual(problem, k) for k in soft}
        low, high = 0.0, max(k.most / unit for k, unit in units.items())
        while high - low > NEAR * high:
            share = (low + high) / 2
            raises = {k: share * unit for k, unit in units.items()}
            if self._holds(problem, {**raises, **lifts}):
                high = share
            else:
                low = share
        raises = {k: high * unit for k, unit in units.items()}
        for limit in soft:
            enough = raises.pop(limit)
            rest = relaxed(problem, {**raises, **lifts})
            raises[limit] = self._at_most(rest, limit, enough)
        return {**{k: more for k, more in raises.items() if more > 0}, **lifts}

    def _at_most(self, problem: Problem, limit: Limit, enough: float) -> float:
        """Return as small a raise as is found, given one that is enough."""
        if self._oracle.is_spent():
            return enough
        if self._holds(problem, {}):
            return 0.0
        low, high = 0.0, enough
        while high - low > NEAR * high:
            middle = (low + high) / 2
            if self._holds(problem, {limit: middle}):
                high = middle
            elif self._oracle.is_spent():
                return high
            else:
                low = middle
        # The roundest number that is enough; one that is no less than `high` is.
        for digits in (1, 2, 3):
            step = 10.0 ** (floor(log10(high)) + 1 - digits)
            rounded = ceil(low / step + 1e-9) * step
            if rounded <= high and self._holds(problem, {limit: rounded}):
                return rounded
        return ceil(high / step - 1e-9) * step

    def _holds(self, problem: Problem, raises: Raises) -> bool:
        return self._oracle.ask(relaxed(problem, raises)) is True


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
    has, share = h.capacity.get(resource, 0.0), _share(h, resource)
    usable = f" ({amount_of(resource, has * share)} usable)" if share != 1 else ""
    text = f"{h.name} has {amount_of(resource, has)} {resource}{usable}"
    return Limit("capacity", (h.name, resource), text, now=has, most=total / share)


def _share(h: Computer, resource: str) -> float:
    """Return how much of a unit of capacity can be used."""
    return (h.speed if resource == "cpu" else 1.0) * (1 - h.reserve.get(resource, 0.0))
