"""What placements and moves cost: work that is not done [core-seconds]."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from benchmarks.regret.traces import NUM_COMPUTERS, STEP, Cores, Placement, Trace

START = 0.3
"""The CPU time to start a component [s]: what a loop assumes of it may be wrong."""
DOWNTIME = 0.05
"""How long a component that moves is paused [s]."""

Move = tuple[int, int]
"""A component, and the computer where it goes."""
Rule = Callable[[int, Placement], Sequence[Move]]
"""Returns what moves after a step, given all until then; moves take no time."""


class Outcome(Struct, frozen=True):
    """What a rule led to; `cost` and what of it was `short` [core-seconds]."""

    cost: float
    short: float
    moves: int


class Costs:
    """All placements of a trace, and what they cost.

    Attributes
    ----------
    placements
        Each one's computer of each component, (n_placements, n_components).
    short
        What components need and do not have, (n_steps, n_placements) [cores]; all of it
        when their computer is lost.
    move
        What the move of a component before a step costs, (n_steps, n_components)
        [core-seconds].
    """

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self.movable = [i for i, pin in enumerate(trace.pins) if pin is None]
        choices = [range(NUM_COMPUTERS) if p is None else (p,) for p in trace.pins]
        self.shape = tuple(len(each) for each in choices)
        self.placements = np.array([*product(*choices)])
        self._index = {tuple(map(int, p)): i for i, p in enumerate(self.placements)}
        self.move = START + DOWNTIME * trace.demands
        self.short = np.zeros((len(trace.demands), len(self.placements)))
        for computer in range(NUM_COMPUTERS):
            needed = trace.demands @ (self.placements == computer).T.astype(float)
            self.short += np.maximum(0.0, needed - trace.left[:, [computer]])

    def index(self, placement: Placement) -> int:
        """Return the number of a placement."""
        return self._index[placement]

    def placement(self, index: int) -> Placement:
        """Return a placement by its number."""
        return tuple(map(int, self.placements[index]))

    def change(self, step: int, placement: Placement) -> Cores:
        """Return what it costs to come to each placement before a step."""
        moved: Cores = (self.placements != placement) @ self.move[step]
        return moved

    def stranded(self, step: int) -> npt.NDArray[np.bool_]:
        """Return which placements have a movable component on a lost computer."""
        lost = self.trace.lost[step][self.placements[:, self.movable]]
        return np.asarray(lost.any(axis=1))

    def neighbours(self, step: int, placement: Placement) -> Iterator[int]:
        """Yield the placements that one move leads to, except to a lost computer."""
        for i in self.movable:
            for computer in np.flatnonzero(~self.trace.lost[step]):
                if computer != placement[i]:
                    yield self.index(after(placement, [(i, int(computer))]))


def after(placement: Placement, moves: Sequence[Move]) -> Placement:
    """Return where components are after moves."""
    computers = list(placement)
    for component, computer in moves:
        computers[component] = computer
    return tuple(computers)


def follow(costs: Costs, rule: Rule) -> Outcome:
    """Return what a rule leads to."""
    placement = costs.trace.start
    short = costs.short[0, costs.index(placement)] * STEP
    moving, number = 0.0, 0
    for step in range(1, len(costs.short)):
        moves = rule(step - 1, placement)
        placement = after(placement, moves)
        moving += sum(costs.move[step, component] for component, _ in moves)
        number += len(moves)
        short += costs.short[step, costs.index(placement)] * STEP
    return Outcome(float(short + moving), float(short), number)
