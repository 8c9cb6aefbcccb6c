"""The smallest relaxation of limits: which must give way, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import ceil, floor, log10
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from poise.model.robot import Computer
from poise.plan.check import MOST
from poise.plan.limits import amount_of
from poise.plan.problem import LinkCapacity, Problem
from poise.plan.records import More

NEAR = 5e-3
"""How close a raise comes to the least that is enough, relative to it."""
MOST_TRIES = 64
"""How many single limits are tried to be raised."""

Change = Callable[[Problem], Problem]


class Asks(Protocol):
    """Says whether a problem can hold."""

    def ask(self, problem: Problem) -> bool | None:
        """Return whether some placement keeps all limits; None when not known."""

    def is_spent(self) -> bool:
        """Return whether it answers no more."""


class Limit(NamedTuple):
    """A limit of a problem, in words, and what it takes to lift it.

    `names` are a computer and its resource (kind ``capacity``), the two ends of a
    ``link``, or the components that are to be ``together``, ``apart`` or on certain
    computers ``only``. The first two kinds can be raised, from `now` on; by `most`,
    they limit nothing any more. `advice` is what to do about the others.
    """

    kind: str
    names: tuple[str, ...]
    text: str
    change: Change | None = None
    advice: str = ""
    now: float = 0.0
    most: float = 0.0

    def covers(self, other: Limit) -> bool:
        """Whether it is `other`, or limits that and more."""
        return self.kind == other.kind and {*self.names} >= {*other.names}

    def lifted(self, problem: Problem) -> Problem:
        """Return the problem without this limit."""
        if self.change is None:
            return self.raised(problem, self.most)
        return self.change(problem)

    def raised(self, problem: Problem, more: float) -> Problem:
        """Return the problem with this limit raised, in its own unit."""
        return _with_raises(problem, [(self, more)])


class Relaxed(NamedTuple):
    """What has to give way; without anything, none was found."""

    raises: list[tuple[Limit, float]]
    lifts: list[Limit]

    def __str__(self) -> str:
        """Return it for people."""
        raises = (
            f"{amount_of(m.resource, m.amount)} more {m.resource} on "
            f"{' - '.join(m.on)} ({amount_of(m.resource, k.now)} now)"
            for m, (k, _) in zip(self.more(), self.raises, strict=True)
        )
        return " and ".join([*raises, *(limit.advice for limit in self.lifts)])

    def more(self) -> tuple[More, ...]:
        """Return the raises as plain records."""
        return tuple(
            More(on=limit.names, resource="bandwidth", amount=amount)
            if limit.kind == "link"
            else More(on=limit.names[:1], resource=limit.names[1], amount=amount)
            for limit, amount in self.raises
        )


class Relaxation:
    """Looks for what must give way; `conflicts` names the limits that are broken."""

    def __init__(
        self,
        oracle: Asks,
        conflicts: Callable[[Problem], tuple[Problem, list[Limit], bool] | None],
    ) -> None:
        self._oracle = oracle
        self._conflicts = conflicts

    def find(self, problem: Problem, limits: list[Limit]) -> Relaxed:
        """Return what has to give way, so that the whole problem holds.

        One limit of those in conflict, the one whose raise is the smallest share of
        what computers have; else several, none of which is needless.
        """
        whole = list(limits_of(problem))
        limits = [next(k for k in whole if k.covers(limit)) for limit in limits]
        ways = []
        for limit in limits[:MOST_TRIES]:
            more = self._least(problem, limit)
            if more is not None:
                ways.append((more / _usual(problem, limit), limit, more))
        if ways:
            _, limit, more = min(ways, key=lambda way: way[0])
            return Relaxed([(limit, more)], [])
        return self._several(problem, limits)

    def _least(self, problem: Problem, limit: Limit) -> float | None:
        """Return the least raise of one limit after which all holds, or None."""
        most = limit.most
        if most <= 0 or not self._holds(limit.raised(problem, most)):
            return None
        return self._at_most(problem, limit, most)

    def _several(self, problem: Problem, limits: list[Limit]) -> Relaxed:
        """Lift what is in conflict, over and over; then take back what was needless."""
        chosen: list[Limit] = []
        now = problem
        while not self._holds(now):
            lifted = [limit for limit in limits if limit.most > 0] or limits[-1:]
            if not lifted:
                return Relaxed([], [])
            now = _after(now, [], lifted)
            chosen += lifted
            found = self._conflicts(now)
            limits = [
                limit
                for limit in limits_of(problem)
                if found and any(limit.covers(other) for other in found[1])
                if not any(limit.covers(other) for other in chosen)
            ]
        return self._with_less(problem, chosen)

    def _with_less(self, problem: Problem, chosen: list[Limit]) -> Relaxed:
        """Return a relaxation of some of these limits: none more than is needed."""
        lifts = [limit for limit in chosen if limit.advice]
        for limit in [*lifts]:
            others = [other for other in chosen if other is not limit]
            if self._holds(_after(problem, [], others)):
                lifts.remove(limit)
                chosen = others
        soft = sorted((k for k in chosen if not k.advice), key=lambda k: k.names)
        base = _after(problem, [], lifts)
        if not soft or self._holds(base):
            return Relaxed([], lifts)
        # All alike first, in shares of what is usual; then one by one.
        usual = [_usual(problem, limit) for limit in soft]
        low, high = 0.0, max(k.most / u for k, u in zip(soft, usual, strict=True))
        while high - low > NEAR * high:
            share = (low + high) / 2
            raises = [(k, share * u) for k, u in zip(soft, usual, strict=True)]
            if self._holds(_after(base, raises, [])):
                high = share
            else:
                low = share
        raises = [(k, high * u) for k, u in zip(soft, usual, strict=True)]
        for i, (limit, now) in enumerate(raises):
            rest = _after(base, raises[:i] + raises[i + 1 :], [])
            raises[i] = limit, self._at_most(rest, limit, now)
        return Relaxed([(k, more) for k, more in raises if more > 0], lifts)

    def _at_most(self, problem: Problem, limit: Limit, enough: float) -> float:
        """Return as small a raise as is found, given one that is enough."""
        if self._oracle.is_spent():
            return enough
        if self._holds(problem):
            return 0.0
        low, high = 0.0, enough
        while high - low > NEAR * high:
            middle = (low + high) / 2
            if self._holds(limit.raised(problem, middle)):
                high = middle
            elif self._oracle.is_spent():
                return high
            else:
                low = middle
        return _rounded(problem, limit, low, high, self._holds)

    def _holds(self, problem: Problem) -> bool:
        return self._oracle.ask(problem) is True


def _after(
    problem: Problem, raises: list[tuple[Limit, float]], lifts: list[Limit]
) -> Problem:
    raises = [*raises, *((k, k.most) for k in lifts if k.change is None)]
    problem = _with_raises(problem, raises) if raises else problem
    for limit in lifts:
        if limit.change is not None:
            problem = limit.change(problem)
    return problem


def _rounded(
    problem: Problem,
    limit: Limit,
    low: float,
    high: float,
    holds: Callable[[Problem], bool],
) -> float:
    """Return the roundest number that is enough; one that is no less than `high` is."""
    for digits in (1, 2, 3):
        step = 10.0 ** (floor(log10(high)) + 1 - digits)
        rounded = ceil(low / step + 1e-9) * step
        if rounded <= high and holds(limit.raised(problem, rounded)):
            return rounded
    return ceil(high / step - 1e-9) * step


def _usual(problem: Problem, limit: Limit) -> float:
    """Return what the largest limit of this kind is, to measure a raise by."""
    if limit.kind == "link":
        return limit.now or 1.0
    return max(h.capacity.get(limit.names[1], 0.0) for h in problem.computers) or 1.0


def limits_of(problem: Problem) -> Iterator[Limit]:
    """Yield each limit of a problem."""
    for resource in problem.resources:
        total = sum(c.demand.get(resource, 0.0) for c in problem.components)
        if total > 0:
            for h in problem.computers:
                yield _capacity(h, resource, total)
    traffic = sum(k.traffic for k in problem.connectors)
    if traffic > 0:
        for link in problem.links:
            yield _link(link, traffic)
    yield from _groups("together", problem.together, "run apart")
    yield from _groups("apart", problem.apart, "share a computer")
    for c in problem.components:
        if c.only:
            why = f" ({c.why})" if c.why else ""
            text = f"{c.name} may only run on {' or '.join(c.only)}{why}"
            advice = f"letting {c.name} run elsewhere"
            yield Limit("only", (c.name,), text, _without_pin(c.name), advice)


def _groups(
    kind: str, groups: tuple[tuple[str, ...], ...], advice: str
) -> Iterator[Limit]:
    for group in groups:
        if len(group) > 1:
            text, names = f"{kind}: {', '.join(group)}", " and ".join(group)
            change = _without_group(kind, group)
            yield Limit(kind, group, text, change, f"letting {names} {advice}")


def _capacity(h: Computer, resource: str, total: float) -> Limit:
    has = h.capacity.get(resource, 0.0)
    share = (h.speed if resource == "cpu" else 1.0) * (1 - h.reserve.get(resource, 0.0))
    most = total / share
    usable = f" ({amount_of(resource, has * share)} usable)" if share != 1 else ""
    return Limit(
        "capacity",
        (h.name, resource),
        f"{h.name} has {amount_of(resource, has)} {resource}{usable}",
        now=has,
        most=most,
    )


def _link(link: LinkCapacity, traffic: float) -> Limit:
    return Limit(
        "link",
        link.between,
        f"link {' - '.join(link.between)} carries "
        f"{amount_of('bandwidth', link.bandwidth)}",
        now=link.bandwidth,
        most=traffic,
    )


def _with_raises(problem: Problem, raises: Iterable[tuple[Limit, float]]) -> Problem:
    """Return the problem with more of some capacities and bandwidths, made once."""
    capacities: dict[str, dict[str, float]] = {}
    bandwidths: dict[tuple[str, ...], float] = {}
    for limit, more in raises:
        if limit.kind == "link":
            bandwidths[limit.names] = more
        else:
            capacities.setdefault(limit.names[0], {})[limit.names[1]] = more
    return replace(
        problem,
        computers=tuple(
            replace(h, capacity=_more_capacity(h.capacity, capacities[h.name]))
            if h.name in capacities
            else h
            for h in problem.computers
        ),
        links=tuple(
            replace(k, bandwidth=min(k.bandwidth + bandwidths[k.between], MOST))
            if k.between in bandwidths
            else k
            for k in problem.links
        ),
    )


def _more_capacity(
    has: Mapping[str, float], more: Mapping[str, float]
) -> dict[str, float]:
    raised = {r: min(has.get(r, 0.0) + amount, MOST) for r, amount in more.items()}
    return {**has, **raised}


def _without_pin(name: str) -> Change:
    def change(problem: Problem) -> Problem:
        return replace(
            problem,
            components=tuple(
                replace(c, only=()) if c.name == name else c for c in problem.components
            ),
        )

    return change


def _without_group(kind: str, group: tuple[str, ...]) -> Change:
    def change(problem: Problem) -> Problem:
        rest = tuple(g for g in getattr(problem, kind) if g != group)
        return replace(problem, **{kind: rest})

    return change
