"""Fleets of up to a million components, straight into the core."""

from __future__ import annotations

from array import array
from random import Random

from poise.plan._core import Core


def agents(components: int, computers: int, seed: int = 1, load: float = 0.7) -> Core:
    """Return a fleet of robots like those of `random_robots`, as flat tables."""
    random = Random(seed)
    demand = array("d", (random.lognormvariate(0, 0.7) for _ in range(2 * components)))
    for k in (0, 1):
        factor = load * computers / sum(demand[k::2])
        for i in range(k, 2 * components, 2):
            demand[i] *= factor
    first, second, overhead = _connectors(random, components)
    size = array("d", (demand[2 * i] + demand[2 * i + 1] for i in range(components)))
    capacity = array("d", [1.0]) * (2 * computers)
    none, nobody = array("d"), array("i")
    return Core(
        components,
        computers,
        2,
        demand,
        capacity,
        capacity,
        size,
        nobody,
        array("i", [0]),
        nobody,
        first,
        second,
        overhead,
        array("d", bytes(8 * len(first))),
        none,
        none,
        none,
        nobody,
        nobody,
        0.5 / sum(overhead),
        array("d", [0.25, 0.25]),
        True,
        False,
    )


def _connectors(
    random: Random, components: int
) -> tuple[array[int], array[int], array[float]]:
    first, second, overhead = array("i"), array("i"), array("d")

    def connect(i: int, j: int) -> None:
        first.append(i)
        second.append(j)
        overhead.append(random.uniform(0.1, 3))

    start = 0
    while start < components:
        size = min(random.randint(3, 8), components - start)
        for i in range(start + 1, start + size):
            connect(random.randrange(start, i), i)
        for _ in range(size // 2):
            i, j = (random.randrange(start, start + size) for _ in range(2))
            if i != j:
                connect(i, j)
        if start:
            connect(random.randrange(start), start)
        start += size
    return first, second, overhead
