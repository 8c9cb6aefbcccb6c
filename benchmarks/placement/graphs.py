"""Seeded graphs of public kinds, to be cut into blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import log
from random import Random

Pairs = list[tuple[int, int]]


def grid(count: int, _random: Random) -> tuple[int, Pairs]:
    """Return a square mesh."""
    side = round(count**0.5)
    pairs = [
        (y * side + x, y * side + x + 1) for y in range(side) for x in range(side - 1)
    ]
    pairs += [(i, i + side) for i in range(side * (side - 1))]
    return side * side, pairs


def cube(count: int, _random: Random) -> tuple[int, Pairs]:
    """Return a mesh in three dimensions."""
    side = round(count ** (1 / 3))
    points = range(side**3)
    pairs = [(i, i + 1) for i in points if i % side < side - 1]
    pairs += [(i, i + side) for i in points if i // side % side < side - 1]
    pairs += [(i, i + side * side) for i in points if i // side**2 < side - 1]
    return side**3, pairs


def geometric(count: int, random: Random) -> tuple[int, Pairs]:
    """Return random points of a square, connected when they are near."""
    reach = 0.55 * (log(count) / count) ** 0.5
    # In strips, so that neighbours have near numbers, as in meshes of practice.
    points = sorted(
        ((random.random(), random.random()) for _ in range(count)),
        key=lambda p: (int(p[0] / reach), p[1]),
    )
    cells: dict[tuple[int, int], list[int]] = {}
    for i, (x, y) in enumerate(points):
        cells.setdefault((int(x / reach), int(y / reach)), []).append(i)
    return count, list(_near(points, cells, reach))


def _near(
    points: list[tuple[float, float]],
    cells: dict[tuple[int, int], list[int]],
    reach: float,
) -> Iterator[tuple[int, int]]:
    for (a, b), mine in cells.items():
        others = [
            j
            for p in (a - 1, a, a + 1)
            for q in (b - 1, b, b + 1)
            for j in cells.get((p, q), ())
        ]
        for i in mine:
            x, y = points[i]
            for j in others:
                u, v = points[j]
                if i < j and (u - x) ** 2 + (v - y) ** 2 < reach * reach:
                    yield i, j


def delaunay(count: int, random: Random) -> tuple[int, Pairs]:
    """Return the Delaunay triangulation of random points of a square."""
    from scipy.spatial import Delaunay  # noqa: PLC0415 - an extra

    points = [(random.random(), random.random()) for _ in range(count)]
    pairs = {
        (min(i, j), max(i, j))
        for a, b, c in Delaunay(points).simplices.tolist()
        for i, j in ((a, b), (b, c), (a, c))
    }
    return count, sorted(pairs)


def scale_free(count: int, random: Random) -> tuple[int, Pairs]:
    """Return Barabasi and Albert's graph: a few nodes have very many neighbours."""
    each = 4
    ends = list(range(each))
    pairs = []
    for i in range(each, count):
        chosen: set[int] = set()
        while len(chosen) < each:
            chosen.add(random.choice(ends))
        pairs += [(j, i) for j in sorted(chosen)]
        ends += [*sorted(chosen), *[i] * each]
    return count, pairs


def robots(count: int, random: Random) -> tuple[int, Pairs]:
    """Return sub-architectures of 3 to 8 components, tied to others near and far."""
    pairs: dict[tuple[int, int], None] = {}
    start = 0
    while start < count:
        size = min(random.randint(3, 8), count - start)
        for i in range(start + 1, start + size):
            pairs[random.randrange(start, i), i] = None
        for _ in range(size // 2):
            i, j = sorted(random.randrange(start, start + size) for _ in range(2))
            if i != j:
                pairs[i, j] = None
        if start:
            near = max(0, start - 1 - int(random.expovariate(1 / 40)))
            pairs[random.randrange(start), start] = None
            pairs[near, start + random.randrange(size)] = None
        start += size
    return count, list(pairs)


KINDS: dict[str, Callable[[int, Random], tuple[int, Pairs]]] = {
    "grid": grid,
    "cube": cube,
    "geometric": geometric,
    "Delaunay": delaunay,
    "scale-free": scale_free,
    "robots": robots,
}
