"""The least cost that any rule can have: dynamic programming over placements."""

from __future__ import annotations

from math import inf

import numpy as np

from benchmarks.regret.costs import Costs, Outcome
from benchmarks.regret.traces import STEP


def oracle(costs: Costs) -> Outcome:
    """Return what the best moves lead to, when all that happens is known before.

    The cost of a change is a sum over components, and the same to every other
    computer, so a step takes the least along the axis of one component after the other.
    """
    start = costs.index(costs.trace.start)
    least = np.full(len(costs.placements), inf)
    least[start] = costs.short[0, start] * STEP
    all_least = [least]
    for move, short in zip(costs.move[1:], costs.short[1:], strict=True):
        least = least.reshape(costs.shape)
        for axis in costs.movable:
            least = np.minimum(least, least.min(axis=axis, keepdims=True) + move[axis])
        least = least.reshape(-1) + short * STEP
        all_least.append(least)
    at = int(np.argmin(least))
    best, short_of, moves = float(least[at]), 0.0, 0
    for step in range(len(all_least) - 1, 0, -1):
        short_of += costs.short[step, at] * STEP
        now = costs.placements[at]
        change = costs.change(step, costs.placement(at))
        at = int(np.argmin(all_least[step - 1] + change))
        moves += int((costs.placements[at] != now).sum())
    return Outcome(best, float(short_of + all_least[0][at]), moves)
