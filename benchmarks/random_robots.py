"""Seeded random robots to place: what all placement benchmarks are run on."""

from __future__ import annotations

from random import Random
from typing import Literal

from poise.model import Computer, Objective
from poise.plan import Edge, Item, Problem


def random_robot(  # noqa: PLR0913 - the knobs of the generator
    seed: int,
    components: int,
    computers: int,
    *,
    spread: Literal["range", "variance"] = "range",
    load: float | None = None,
    degree: float = 3.0,
    pinned: float = 0.1,
    uneven: bool = False,
) -> Problem:
    """Return a robot like those of the paper, as a problem.

    Sub-architectures of 3 to 8 components, each connected within itself with about
    `degree` connectors a component, and a few connectors between them; `cpu` and
    `memory`; a share `pinned` of the components held to one computer, half as many to
    either of two. Demands fill `load` of the capacity (None: 60 to 90 %). `uneven`
    computers differ up to four times in capacity.
    """
    random = Random(seed)
    share = load if load is not None else random.uniform(0.6, 0.9)
    names = [f"computer{h}" for h in range(computers)]
    parts = [f"component{i}" for i in range(components)]
    capacity = [random.uniform(1, 4) if uneven else 1.0 for _ in names]
    demands = {
        resource: _demands(random, components, share * sum(capacity))
        for resource in ("cpu", "memory")
    }
    pairs = _connectors(random, components, degree)
    return Problem(
        components=tuple(
            Item(
                name=name,
                demand={r: amounts[i] for r, amounts in demands.items()},
                only=_only(random, names, pinned),
            )
            for i, name in enumerate(parts)
        ),
        computers=tuple(
            Computer(name=name, capacity={"cpu": size, "memory": size})
            for name, size in zip(names, capacity, strict=True)
        ),
        connectors=tuple(
            Edge(between=(parts[i], parts[j]), overhead=random.uniform(0.1, 3))
            for i, j in pairs
        ),
        objective=Objective(spread=spread),
    )


def _demands(random: Random, count: int, total: float) -> list[float]:
    raw = [random.lognormvariate(0, 0.7) for _ in range(count)]
    return [x * total / sum(raw) for x in raw]


def _connectors(
    random: Random, components: int, degree: float
) -> list[tuple[int, int]]:
    pairs: dict[tuple[int, int], None] = {}
    start = 0
    while start < components:
        size = min(random.randint(3, 8), components - start)
        members = range(start, start + size)
        for i in members[1:]:
            pairs[random.randrange(start, i), i] = None
        wanted = min(round(degree * size / 2), size * (size - 1) // 2)
        inside = size - 1
        while inside < wanted:
            i, j = sorted(random.sample(members, 2))
            inside += (i, j) not in pairs
            pairs[i, j] = None
        if start:
            pairs[random.randrange(start), random.choice(members)] = None
        start += size
    return list(pairs)


def _only(random: Random, names: list[str], pinned: float) -> tuple[str, ...]:
    dice = random.random()
    if dice < pinned:
        return (random.choice(names),)
    if dice < 1.5 * pinned and len(names) > 2:
        return tuple(random.sample(names, 2))
    return ()
