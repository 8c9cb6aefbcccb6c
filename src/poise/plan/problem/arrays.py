"""A problem in flat arrays of numbers: what the C++ core reads.

Components that must share a computer become one *unit*; everything below is by unit.
Arrays are flat, row by row. After the columns of resources come those of soft limits,
as if each were a resource of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import inf, isqrt

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import UsageError
from poise.model.robot import Computer, Link
from poise.plan.problem.items import Edge, Item, SoftLimit
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
    """Return the time limits in numbers; None when there are none."""
    if not problem.time_limits:
        return None
    resources = problem.resources
    cpu = resources.index("cpu") if "cpu" in resources else -1
    limits: list[LimitArray] = []
    for limit in problem.time_limits:
        runs = [(index[run.component], run.seconds) for run in limit.runs]
        hops = [
            (index[a], index[b], hop.seconds, hop.crossings, hop.size)
            for hop in limit.hops
            for a, b in [hop.between]
        ]
        shares = cpu if limit.shared else -1
        limits.append((limit.limit, limit.price, limit.fixed, shares, runs, hops))
    queues = [queue_of(h) for h in problem.computers]
    return Times(
        limits,
        [h.speed for h in problem.computers],
        [cores for cores, _ in queues],
        [power for _, power in queues],
        _of_links(problem, (0, 0), lambda link: link.latency, max),
        _of_links(problem, (0, 0), lambda link: 1 / max(link.bandwidth, LEAST), max),
    )


def queue_of(computer: Computer) -> tuple[int, int]:
    """Return how many cores runs wait for, and the power in the formula of that."""
    cores = max(1, int(min(computer.capacity.get("cpu", 0.0), MOST_CORES)))
    return cores, max(1, isqrt(2 * (cores + 1)) - 1)


Placed = list[int]
"""For every unit the index of its computer, or -1 while it has none."""


class Arrays(Struct, frozen=True):
    """The numbers of a problem; n units, m computers, r resources and soft limits."""

    problem: Problem
    members: list[tuple[int, ...]]  # unit -> indexes of its components
    unit_of: list[int]  # component -> its unit
    index: dict[str, int]  # name of a component -> its place among the components
    component_demand: list[float]  # (components, r)
    resources: tuple[str, ...]
    demand: list[float]  # (n, r)
    # capacity, limit: (m, r): what a computer has, and what placements may use of it;
    # infinite for a resource that has soft limits
    capacity: list[float]
    limit: list[float]
    # (r,): what F grows by for each unit beyond a limit; 0: it must be kept
    price: list[float]
    # (r,): the greedy orders by the sum of demand times this, largest first
    size_weight: list[float]
    # unit -> computers it may run on; units that are not named may run on any
    allowed: dict[int, tuple[int, ...]]
    # each pair of connected units: one, the other, overhead, traffic
    connectors: list[tuple[int, int, float, float]]
    distance: list[float]  # (m, m), or empty: 1 between any two computers
    # (n, m), or empty: 0. Includes what leaving the present computer costs
    cost: list[float]
    bandwidth: list[float]  # (m, m), or empty: unlimited
    # pairs of units that must not share a computer, each once
    apart: list[tuple[int, int]]
    # overhead, traffic: Of all pairs of units together that some placement has apart
    overhead: float
    traffic: float
    communication: float  # what a unit of overhead x distance adds to F
    spread: list[float]  # (r,): what a unit of spread adds to F
    share: bool  # whether residue is measured as a share of capacity
    # whether spread is the population variance, else largest minus smallest
    variance: bool
    n: int
    m: int
    r: int
    times: Times | None = None  # the time limits, where there are any

    def name(self, unit: int) -> str:
        """Return the names of a unit's components, joined."""
        return "+".join(self.names([unit]))

    def names(self, units: Iterable[int]) -> tuple[str, ...]:
        """Return the names of the components of some units."""
        components = self.problem.components
        return tuple(components[i].name for u in units for i in self.members[u])

    def computer(self, index: int) -> str:
        """Return the name of a computer."""
        return self.problem.computers[index].name

    def placed(self, placement: Mapping[str, str]) -> Placed:
        """Return a placement by name as one by index."""
        index = {h.name: i for i, h in enumerate(self.problem.computers)}
        placed = [-1] * self.n
        for component, unit in zip(self.problem.components, self.unit_of, strict=True):
            name = placement.get(component.name)
            if name not in index:
                raise UsageError(
                    f"component {component.name!r} is placed on {name!r} "
                    f"(there are: {', '.join(index)})"
                )
            if placed[unit] not in {-1, index[name]}:
                names = ", ".join(self.names([unit]))
                raise UsageError(f"{names} must share a computer")
            placed[unit] = index[name]
        return placed

    def placement(self, placed: Placed) -> dict[str, str]:
        """Return a placement by index as one by name."""
        names = [computer.name for computer in self.problem.computers]
        return {
            c.name: names[placed[unit]]
            for c, unit in zip(self.problem.components, self.unit_of, strict=True)
        }


def arrays_of(problem: Problem, given: Mapping[str, str] | None = None) -> Arrays:
    """Turn a problem into numbers.

    Sets that must share a computer and do not, in a placement that is `given`, are no
    units; F counts as if they were.
    """
    if given is not None and next(split_groups(problem, given), None):
        whole = arrays_of(problem)
        scale = overhead_scale(problem, whole.overhead, whole.traffic)
        problem = replace(problem, overhead_scale=scale)
    components, computers = problem.components, problem.computers
    resources = problem.resources
    index = {c.name: i for i, c in enumerate(components)}
    place = {h.name: i for i, h in enumerate(computers)}
    unit_of, members = _units(problem, index, given or {})
    n, m, r = len(members), len(computers), len(resources)
    demand = [c.demand.get(k, 0.0) for c in components for k in resources]
    capacity = [h.total(k) for h in computers for k in resources]
    limit = [h.usable(k) for h in computers for k in resources]
    unit = {name: unit_of[i] for name, i in index.items()} if n < len(index) else index
    connectors = _connectors(problem.connectors, unit)
    allowed = _allowed(problem, place, unit_of)
    overhead, traffic = _separable(problem, connectors, allowed, unit)
    objective = problem.objective
    arrays = Arrays(
        problem,
        members,
        unit_of,
        index,
        demand,
        resources,
        demand if unit is index else _summed(demand, unit_of, n, r),
        capacity,
        limit,
        [0.0] * r,
        _size_weights(problem, resources, limit),
        allowed,
        connectors,
        _of_links(problem, (0, 1), lambda link: link.distance, lambda _, last: last),
        _linear(problem, place, unit_of, n),
        _of_links(problem, (inf, inf), lambda link: link.bandwidth, min),
        _apart(problem, unit),
        overhead,
        traffic,
        objective.communication * overhead_scale(problem, overhead, traffic),
        [objective.balance * w for w in _balance_weights(problem, resources)],
        objective.scale == "normalised",
        objective.spread == "variance",
        n,
        m,
        r,
        times_of(problem, index),
    )
    return _with_soft_limits(arrays) if problem.soft_limits else arrays


def _with_soft_limits(arrays: Arrays) -> Arrays:
    """Return the numbers with a column for each soft limit of the problem."""
    problem, resources = arrays.problem, arrays.resources
    soft, r = problem.soft_limits, arrays.r
    counts = [[_counts(limit, c) for limit in soft] for c in problem.components]
    has = [[h.total(limit.resource) for limit in soft] for h in problem.computers]
    most = [
        [limit.limits.get(h.name, h.usable(limit.resource)) for limit in soft]
        for h in problem.computers
    ]
    demand = _beside(arrays.component_demand, r, counts)
    softened = {limit.resource for limit in soft}
    hard = [
        inf if resources[e % r] in softened else x for e, x in enumerate(arrays.limit)
    ]
    none = [0.0] * len(soft)
    return replace(
        arrays,
        component_demand=demand,
        demand=_summed(demand, arrays.unit_of, arrays.n, r + len(soft)),
        capacity=_beside(arrays.capacity, r, has),
        limit=_beside(hard, r, most),
        price=[*arrays.price, *(limit.price for limit in soft)],
        size_weight=[*arrays.size_weight, *none],
        spread=[*arrays.spread, *none],
        r=r + len(soft),
    )


def _counts(limit: SoftLimit, component: Item) -> float:
    """Return how much of a component's demand counts for a soft limit."""
    if limit.components is not None and component.name not in limit.components:
        return 0.0
    return component.demand.get(limit.resource, 0.0)


def _beside(values: list[float], width: int, more: list[list[float]]) -> list[float]:
    """Return rows of `width` values, each with more behind them."""
    rows = (values[i * width : (i + 1) * width] + row for i, row in enumerate(more))
    return [value for row in rows for value in row]


def _separable(
    problem: Problem,
    connectors: list[tuple[int, int, float, float]],
    allowed: dict[int, tuple[int, ...]],
    unit: dict[str, int],
) -> tuple[float, float]:
    """Return overhead and traffic of all pairs that some placement has apart."""
    if problem.architectures:
        usual = problem.usual_connectors
        if usual is not problem.connectors:
            connectors = _connectors(usual, unit)
    held = {u: there for u, there in allowed.items() if len(there) == 1}
    overhead = traffic = 0.0
    for i, j, pays, sends in connectors:
        if i not in held or held[i] != held.get(j):
            overhead += pays
            traffic += sends
    return overhead, traffic


def split_groups(
    problem: Problem, placement: Mapping[str, str]
) -> Iterator[tuple[str, ...]]:
    """Yield the sets that must share a computer and do not in a placement."""
    for group in problem.together:
        if len({placement[name] for name in group if name in placement}) > 1:
            yield group


def _units(
    problem: Problem, index: dict[str, int], given: Mapping[str, str]
) -> tuple[list[int], list[tuple[int, ...]]]:
    count = len(problem.components)
    if not problem.together:
        return list(range(count)), [(i,) for i in range(count)]
    root = list(range(count))
    split = [*split_groups(problem, given)]
    for group in problem.together:
        if group in split:
            continue
        merged = {root[index[name]] for name in group}
        lowest = min(merged, default=0)
        root = [lowest if k in merged else k for k in root]
    units: dict[int, list[int]] = {}
    for i, k in enumerate(root):
        units.setdefault(k, []).append(i)
    unit_of = [0] * count
    for u, inside in enumerate(units.values()):
        for i in inside:
            unit_of[i] = u
    return unit_of, [tuple(inside) for inside in units.values()]


def _summed(values: list[float], unit_of: list[int], n: int, r: int) -> list[float]:
    total = [0.0] * (n * r)
    for i, unit in enumerate(unit_of):
        for k in range(r):
            total[unit * r + k] += values[i * r + k]
    return total


def _connectors(
    connectors: Iterable[Edge], unit: dict[str, int]
) -> list[tuple[int, int, float, float]]:
    joined: dict[tuple[int, int], tuple[float, float]] = {}
    for connector in connectors:
        a, b = connector.between
        i, j = unit[a], unit[b]
        if i == j:
            continue
        pair = (i, j) if i < j else (j, i)
        overhead, traffic = connector.overhead, connector.traffic
        if pair in joined:
            overhead += joined[pair][0]
            traffic += joined[pair][1]
        joined[pair] = overhead, traffic
    return [(i, j, o, t) for (i, j), (o, t) in joined.items()]


def _balance_weights(problem: Problem, resources: tuple[str, ...]) -> list[float]:
    """Return the weight of each resource's spread (docs/design/objective.md)."""
    given, is_paper = problem.objective.weights, problem.objective.scale == "paper"
    if is_paper and not given and "cpu" in resources:
        given = {"cpu": 1.0}
    weights = [given.get(k, 0.0) if given else 1.0 for k in resources]
    total = 1.0 if is_paper else sum(weights)
    return [w / total for w in weights] if total > 0 else weights


def _size_weights(
    problem: Problem, resources: tuple[str, ...], limit: list[float]
) -> list[float]:
    """Return the paper's weights of demand in a size, by which the greedy orders."""
    given = problem.objective.sizes
    weights = [given.get(k, 0.0) if given else 1.0 for k in resources]
    if problem.objective.scale == "paper":
        return weights
    r = len(resources)
    totals = [sum(limit[k::r]) for k in range(r)]
    return [w / t if t > 0 else 0.0 for w, t in zip(weights, totals, strict=True)]


def _allowed(
    problem: Problem, place: dict[str, int], unit_of: list[int]
) -> dict[int, tuple[int, ...]]:
    allowed: dict[int, tuple[int, ...]] = {}
    for i, component in enumerate(problem.components):
        if component.only or component.stranded:
            mine = {place[name] for name in component.only}
            unit = unit_of[i]
            if unit in allowed:
                mine.intersection_update(allowed[unit])
            allowed[unit] = tuple(sorted(mine))
    return allowed


def _linear(
    problem: Problem, place: dict[str, int], unit_of: list[int], n: int
) -> list[float]:
    m = len(place)
    costly = [
        (unit_of[i] * m, c)
        for i, c in enumerate(problem.components)
        if c.cost or (c.present and c.move_cost > 0)
    ]
    if not costly:
        return []
    total = [0.0] * (n * m)
    for row, component in costly:
        for name, cost in component.cost.items():
            total[row + place[name]] += cost
    for row, component in costly:
        for name, h in place.items():
            if component.present not in {None, name}:
                total[row + h] += component.move_cost
    return total


def _of_links(
    problem: Problem,
    usual: tuple[float, float],
    value_of: Callable[[Link], float],
    worse: Callable[[float, float], float],
) -> list[float]:
    """Return a value for each pair of computers, (m, m); empty: all are as `usual`.

    `usual` is for a computer with itself, and for two without a link.
    """
    here, apart = usual
    values = [value_of(link) for link in problem.links]
    if all(value == apart for value in values):
        return []
    place = {h.name: i for i, h in enumerate(problem.computers)}
    m = len(place)
    table = [float(here if a == b else apart) for a in range(m) for b in range(m)]
    for link, value in zip(problem.links, values, strict=True):
        a, b = (place[name] for name in link.between)
        table[a * m + b] = table[b * m + a] = worse(table[a * m + b], value)
    return table


def _apart(problem: Problem, unit: dict[str, int]) -> list[tuple[int, int]]:
    pairs: dict[tuple[int, int], None] = {}
    for group in (*problem.apart, *problem.exclusive.values()):
        units = [unit[name] for name in group]
        for x, i in enumerate(units):
            for j in units[x + 1 :]:
                pairs[min(i, j), max(i, j)] = None
    return list(pairs)


LEAST_LINK_USE = 0.1
"""What communication counts for at least, however little of the links it takes: a
message between computers costs time on both of them, too."""


def overhead_scale(problem: Problem, overhead: float, traffic: float) -> float:
    """Return what a unit of overhead counts for in the communication term.

    In the normalised scale all overhead together counts for the share of the narrowest
    link that all traffic together would take, between a tenth and 1; for 1 where no
    bandwidth or no traffic is known.
    """
    if problem.objective.scale == "paper":
        return 1.0
    if problem.overhead_scale is not None:
        return problem.overhead_scale
    if overhead <= 0:
        return 0.0
    narrowest = min((link.bandwidth for link in problem.links), default=inf)
    use = traffic / narrowest if traffic > 0 and 0 < narrowest < inf else 1.0
    return min(1.0, max(LEAST_LINK_USE, use)) / overhead
