"""Tiny named problems that the tests of the planner share."""

import pytest

from poise.model.robot import Computer, Objective
from poise.plan import Edge, Item, Problem


@pytest.fixture
def paper_example() -> Problem:
    """Return the worked example of the paper, section IV-D, table I."""
    demands = {"C1": (20, 5), "C2": (40, 10), "C3": (15, 4)}
    overheads = {("C1", "C2"): 1.5, ("C1", "C3"): 1.0, ("C2", "C3"): 2.0}
    return Problem(
        components=tuple(
            Item(name=name, demand={"cpu": cpu, "memory": memory})
            for name, (cpu, memory) in demands.items()
        ),
        computers=tuple(
            Computer(name=name, capacity={"cpu": 100, "memory": 100})
            for name in ("SBC1", "SBC2")
        ),
        connectors=tuple(
            Edge(between=pair, overhead=overhead)
            for pair, overhead in overheads.items()
        ),
        objective=Objective(
            communication=5,
            balance=1,
            scale="paper",
            sizes={"cpu": 1, "memory": 3},
        ),
    )


@pytest.fixture
def two_computers() -> Problem:
    """Return two chatting pairs on a large and a small computer."""
    return Problem(
        components=tuple(
            Item(name=name, demand={"cpu": 1.0}) for name in ("a", "b", "c", "d")
        ),
        computers=(
            Computer(name="large", capacity={"cpu": 4.0}),
            Computer(name="small", capacity={"cpu": 2.0}),
        ),
        connectors=(
            Edge(between=("a", "b"), overhead=3.0),
            Edge(between=("c", "d"), overhead=1.0),
        ),
    )
