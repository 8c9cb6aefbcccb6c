"""Random problems of every kind, for the laws that hold for all of them."""

from itertools import combinations, product
from math import inf
from random import Random

from hypothesis import strategies as st
from msgspec.structs import replace

from poise.model.robot import Computer, Link, Objective
from poise.plan import Edge, Hop, Item, Problem, Run, TimeLimit
from poise.plan.problem.arrays import arrays_of
from poise.plan.violations import violations
from tests.plan.reference import objective

AMOUNTS = st.sampled_from([0.0, 0.1, 0.25, 0.5, 1.0, 1.5, 3.0])
SHARES = st.sampled_from([0.0, 0.5, 1.0, 2.0])


@st.composite
def problems(
    draw: st.DrawFn, most_components: int = 8, most_computers: int = 4
) -> Problem:
    """Return a problem with any mix of limits; it may have no solution."""
    m = draw(st.integers(1, most_computers))
    n = draw(st.integers(0, most_components))
    computers = [f"h{i}" for i in range(m)]
    components = [f"c{i}" for i in range(n)]
    resources = draw(st.sampled_from([("cpu",), ("cpu", "memory"), ("cpu", "x", "y")]))
    costs = draw(st.booleans())
    pairs = st.lists(
        st.tuples(st.sampled_from(components), st.sampled_from(components)),
        max_size=2 * n,
    )
    return Problem(
        components=tuple(
            Item(
                name=name,
                demand={r: draw(AMOUNTS) for r in resources},
                only=tuple(draw(_some(computers))),
                present=draw(st.sampled_from([None, *computers])),
                move_cost=draw(st.sampled_from([0.0, 0.0, 0.1])),
                cost={h: 0.1 * (i % (k + 2)) for k, h in enumerate(computers) if costs},
            )
            for i, name in enumerate(components)
        ),
        computers=tuple(
            Computer(
                name=name,
                capacity={r: draw(st.sampled_from([0.0, 2.0, 4.0])) for r in resources},
                speed=draw(st.sampled_from([1.0, 1.0, 2.0])),
                reserve=draw(st.sampled_from([{}, {}, {"cpu": 0.25}])),
            )
            for name in computers
        ),
        connectors=tuple(
            Edge(between=pair, overhead=draw(AMOUNTS), traffic=draw(AMOUNTS))
            for pair in (draw(pairs) if n else [])
        ),
        links=tuple(draw(_links(computers))),
        objective=Objective(
            communication=draw(SHARES),
            balance=draw(SHARES),
            scale=draw(st.sampled_from(["normalised", "paper"])),
            spread=draw(st.sampled_from(["range", "variance"])),
            weights=draw(st.sampled_from([{}, {"cpu": 1.0}, {"cpu": 1.0, "x": 3.0}])),
        ),
        together=draw(_groups(components)),
        apart=draw(_groups(components)),
        time_limits=draw(_time_limits(components)),
    )


@st.composite
def _time_limits(draw: st.DrawFn, names: list[str]) -> tuple[TimeLimit, ...]:
    """Return none as often as some; their links have latencies of some ms."""
    if not names or draw(st.booleans()):
        return ()
    name = st.sampled_from(names)
    seconds = st.sampled_from([0.0, 0.01, 0.02, 0.05])
    run = st.builds(Run, component=name, seconds=seconds)
    hop = st.builds(
        Hop,
        between=st.tuples(name, name),
        seconds=seconds,
        crossings=st.sampled_from([0.0, 1.0, 2.0]),
        size=st.sampled_from([0.0, 0.02]),
    )
    return tuple(
        TimeLimit(
            name=f"t{i}",
            limit=draw(st.sampled_from([0.03, 0.1, 0.3])),
            fixed=draw(st.sampled_from([0.0, 0.01])),
            runs=tuple(draw(st.lists(run, max_size=4))),
            hops=tuple(draw(st.lists(hop, max_size=4))),
            shared=draw(st.booleans()),
            price=draw(st.sampled_from([0.0, 0.1, 1.0])),
        )
        for i in range(draw(st.integers(1, 3)))
    )


def _some(names: list[str]) -> st.SearchStrategy[list[str]]:
    few = st.lists(st.sampled_from(names), min_size=1, unique=True)
    return st.one_of(st.just([]), st.just([]), few)


def _groups(names: list[str]) -> st.SearchStrategy[tuple[tuple[str, ...], ...]]:
    if len(names) < 2:
        return st.just(())
    group = st.lists(st.sampled_from(names), min_size=2, max_size=3, unique=True)
    one = group.map(lambda members: (tuple(members),))
    return st.one_of(st.just(()), st.just(()), one)


@st.composite
def _links(draw: st.DrawFn, names: list[str]) -> list[Link]:
    distances = st.sampled_from([0.5, 1.0, 2.0]) if draw(st.booleans()) else st.just(1)
    latencies = st.sampled_from([0.0, 0.002, 0.02])
    links = [
        Link(between=pair, distance=draw(distances), latency=draw(latencies))
        for pair in combinations(names, 2)
    ]
    if links and not draw(st.integers(0, 3)):
        bandwidth = draw(st.sampled_from([0.0, 1.0, 3.0]))
        links[0] = replace(links[0], bandwidth=bandwidth)
    return links


def small_robot(seed: int) -> Problem:
    """Return a robot with memory in bytes, pins, links and sets; it may be too full."""
    random = Random(seed)
    components = [f"c{i}" for i in range(random.randint(3, 6))]
    computers = [f"h{i}" for i in range(random.randint(2, 3))]
    pairs = [*combinations(computers, 2)]
    return Problem(
        components=tuple(
            Item(
                name=name,
                demand={
                    "cpu": random.uniform(0.02, 1.2),
                    "memory": random.lognormvariate(19.5, 1.2),
                    **({"gpu": random.choice([0.25, 1.0])} if i % 4 == 3 else {}),
                },
                only=(random.choice(computers),) if random.random() < 0.2 else (),
            )
            for i, name in enumerate(components)
        ),
        computers=tuple(
            Computer(
                name=name,
                capacity={
                    "cpu": random.choice([1.0, 2.0, 4.0]),
                    "memory": random.choice([1, 2, 4]) * 2.0**30,
                    "gpu": float(i % 2),
                },
                speed=random.choice([1.0, 0.8, 1.5]),
            )
            for i, name in enumerate(computers)
        ),
        connectors=tuple(
            Edge(
                between=(a, b),
                overhead=random.uniform(0.01, 3),
                traffic=random.lognormvariate(13, 2),
            )
            for a, b in combinations(components, 2)
            if random.random() < 0.5
        ),
        links=tuple(
            Link(between=pair, bandwidth=random.lognormvariate(14.5, 1.5))
            for pair in pairs
            if random.random() < 0.6
        ),
        objective=Objective(spread=random.choice(["range", "variance"])),
        apart=((components[0], components[1]),) if random.random() < 0.3 else (),
        together=((components[0], components[2]),) if random.random() < 0.3 else (),
    )


def least(problem: Problem) -> float:
    """Return the least F of all placements that keep every limit, by trying all."""
    arrays = arrays_of(problem)
    every = map(list, product(range(arrays.m), repeat=arrays.n))
    return min(
        (
            objective.terms(arrays, placed).total
            for placed in every
            if not violations(arrays, placed)
        ),
        default=inf,
    )
