"""Communication alone, with limits: against METIS and KaHIP.

Every block may hold 3 % more nodes than the mean, rounded up twice as KaHIP does it;
all three get that same limit. Each has 1 s of its thread's CPU time: other work on the
machine takes nothing from it. METIS and KaHIP `eco` stop by themselves: stated are one
call, and the best that keeps the limit of as many calls with different seeds as end in
the second (at least one).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from multiprocessing import get_context
from random import Random
from time import thread_time
from typing import Any, NamedTuple

from benchmarks.placement.graphs import KINDS, Pairs
from benchmarks.placement.table import show
from poise.plan._core import Core

SECONDS = 1.0
LONGEST = 60.0
"""After how long [s, by the clock] the calls are given up."""
BLOCKS = (2, 8, 64)
EXCESS = 0.03
SEED = 7


class Graph(NamedTuple):
    """A graph in rows, as METIS and KaHIP take it, and as pairs."""

    n: int
    pairs: Pairs
    starts: list[int]
    ends: list[int]

    def limit(self, blocks: int) -> int:
        """Return how many nodes a block may hold."""
        return ceil((1 + EXCESS) * ceil(self.n / blocks) - 1e-9)

    def cut(self, part: list[int], blocks: int) -> int | None:
        """Return how many edges are cut; None when a block holds too many nodes."""
        counts = [0] * blocks
        for block in part:
            counts[block] += 1
        if max(counts) > self.limit(blocks):
            return None
        return sum(part[i] != part[j] for i, j in self.pairs)


Partitioner = Callable[[Graph, int, int], list[int]]
"""From a graph, a number of blocks and a seed to each node's block."""


def run(sizes: Sequence[int]) -> list[list[Any]]:
    """Cut one graph of every kind and size [nodes, about], and count who cuts less."""
    rows: list[list[Any]] = []
    leads: list[int | None] = []
    for nodes in sizes:
        for kind, make in KINDS.items():
            try:
                graph = _graph(*make(nodes, Random(SEED)))
            except ImportError:
                continue
            for blocks in BLOCKS:
                cells, lead = _compare(graph, blocks)
                rows.append([kind, f"{graph.n:,}", blocks, *cells])
                leads.append(lead)
    show(
        f"Edges cut in {SECONDS:g} s, {100 * EXCESS:g} % imbalance, "
        "against METIS and KaHIP",
        [
            "graph",
            "nodes",
            "blocks",
            "METIS, one call",
            "METIS, best",
            "KaHIP eco, one call",
            "KaHIP eco, best",
            "search",
            "against the better of both",
        ],
        rows,
    )
    print(_counted([lead for lead in leads if lead is not None]) + "\n", flush=True)
    return rows


def _counted(leads: list[int]) -> str:
    """Say how often `search` cuts less, as much and more."""
    less, more = sum(lead < 0 for lead in leads), sum(lead > 0 for lead in leads)
    return (
        f"Of {len(leads)} rows, `search` cuts less than the better of both in {less}, "
        f"as much in {len(leads) - less - more}, and more in {more}."
    )


def _graph(n: int, pairs: Pairs) -> Graph:
    rows: list[list[int]] = [[] for _ in range(n)]
    for i, j in pairs:
        rows[i].append(j)
        rows[j].append(i)
    starts, ends = [0], []
    for row in rows:
        ends += sorted(row)
        starts.append(len(ends))
    return Graph(n, pairs, starts, ends)


def _compare(graph: Graph, blocks: int) -> tuple[list[str], int | None]:
    """Return the cells of a row, and how much more `search` cuts than the others."""
    ours = graph.cut(_search(graph, blocks, 1), blocks)
    cells, others = [], []
    for partitioner in (_metis, _kahip):
        try:
            seconds, cuts = _calls(partitioner, graph, blocks)
        except ImportError:
            cells += ["not installed", "-"]
            continue
        if not cuts:
            cells += [f"over {LONGEST:g} s", "-"]
            continue
        best = min((c for c in cuts if c is not None), default=None)
        cells += [
            f"{_said(cuts[0])} ({seconds:.2g} s)",
            f"{_said(best)} ({len(cuts)} calls)",
        ]
        others += [best] if best is not None else []
    if not ours or not others:
        return [*cells, _said(ours), "-"], None
    lead = f"{100 * (ours / min(others) - 1):+.1f} %"
    return [*cells, _said(ours), lead], ours - min(others)


def _said(cut: int | None) -> str:
    return "over the limit" if cut is None else f"{cut:,}"


def _calls(
    partitioner: Partitioner, graph: Graph, blocks: int
) -> tuple[float, list[int | None]]:
    """Return how long the first call took, and what each cut; nothing if too long."""
    context = get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_repeat, args=(there, partitioner, graph, blocks))
    process.start()
    there.close()
    parts: list[list[int]] = []
    seconds = LONGEST
    try:
        while here.poll(LONGEST):
            taken, part = here.recv()
            if isinstance(part, ImportError):
                raise part
            if not parts:
                seconds = taken
            parts.append(part)
    except EOFError:
        pass
    process.kill()
    process.join()
    return seconds, [graph.cut(part, blocks) for part in parts]


def _repeat(pipe: Any, partitioner: Partitioner, graph: Graph, blocks: int) -> None:  # noqa: ANN401
    said: list[tuple[float, list[int] | ImportError]] = []
    spent = longest = 0.0
    try:
        while not said or spent + longest < SECONDS:
            start = thread_time()
            part = partitioner(graph, blocks, len(said))
            taken = thread_time() - start
            said.append((taken, part))
            spent += taken
            longest = max(longest, taken)
    except ImportError as error:
        said.append((0.0, error))
    for one in said:
        pipe.send(one)
    pipe.close()


def _metis(graph: Graph, blocks: int, seed: int) -> list[int]:
    import pymetis  # noqa: PLC0415 - an extra

    rows = pymetis.CSRAdjacency(graph.starts, graph.ends)
    spare = graph.limit(blocks) * blocks / graph.n - 1
    options = pymetis.Options(seed=seed, ufactor=int(1000 * spare))
    return list(pymetis.part_graph(blocks, rows, options=options)[1])


def _kahip(graph: Graph, blocks: int, seed: int) -> list[int]:
    import kahip  # noqa: PLC0415 - an extra

    ones = [1] * graph.n, [1] * len(graph.ends)
    eco = 1
    return list(
        kahip.kaffpa(
            ones[0], graph.starts, ones[1], graph.ends, blocks, EXCESS, True, seed, eco
        )[1]
    )


def _search(graph: Graph, blocks: int, seed: int) -> list[int]:
    none: list[float] = []
    nobody: list[int] = []
    ones = [1.0] * graph.n
    room = [float(graph.limit(blocks))] * blocks
    edges = len(graph.pairs)
    core = Core(
        graph.n,
        blocks,
        1,
        ones,
        room,
        room,
        ones,
        nobody,
        [0],
        nobody,
        [i for i, _ in graph.pairs],
        [j for _, j in graph.pairs],
        [1.0] * edges,
        [0.0] * edges,
        none,
        none,
        none,
        nobody,
        nobody,
        1.0,
        [0.0],
        False,
        False,
    )
    return core.search([], SECONDS, 1 << 62, seed, thread_time=True)[0]
