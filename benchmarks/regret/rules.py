"""Rules to compare with, which know the present exactly.

All of them restart at once what was on a computer that is lost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.regret.costs import Costs, Move, Rule, after
from benchmarks.regret.traces import STEP, Placement
from poise.model import Computer
from poise.plan import Item, Problem, solve

HORIZON = 30.0
"""The present is taken to last for so long [s]."""
REST = 3.0
"""`total` rests for so long after a transition [s]; twice as long after the next."""
LONGEST_REST = 300.0
STAY_AWAY = 300.0
"""With `total` no component returns to a computer for so long [s]."""
SOLVE_STEPS = 2000
"""How much the planner searches, so that a run can be repeated."""


def never(costs: Costs) -> Rule:
    """Move nothing, but restart what a lost computer ran where most is left."""

    def rule(step: int, placement: Placement) -> Sequence[Move]:
        trace = costs.trace
        lost, demands = trace.lost[step], trace.demands[step]
        left = trace.left[step].copy()
        np.subtract.at(left, list(placement), demands)
        left[lost] = -np.inf
        stranded = [i for i in costs.movable if lost[placement[i]]]
        moves = []
        for i in sorted(stranded, key=lambda i: -demands[i]):
            computer = int(np.argmax(left))
            left[computer] -= demands[i]
            moves.append((i, computer))
        return moves

    return rule


def ahead(costs: Costs, horizon: float) -> Rule:
    """Take the least of shortage and moves over a horizon [s], once a second."""

    def rule(step: int, placement: Placement) -> Sequence[Move]:
        stranded = costs.stranded(step)
        is_stranded = stranded[costs.index(placement)]
        if step * STEP % 1 and not is_stranded:
            return ()
        cost = costs.short[step] * horizon + costs.change(step, placement)
        best = int(np.argmin(np.where(stranded, np.inf, cost)))
        if not is_stranded and cost[best] >= cost[costs.index(placement)]:
            return ()
        return _moves(placement, costs.placement(best))

    return rule


class Total:
    """Solve for limits that all hold; move when the gain exceeds all moves' cost."""

    def __init__(self, costs: Costs) -> None:
        self._costs = costs
        self._fail_over = never(costs)
        self._rest = REST
        self._rests_until = 0.0
        self._away: dict[Move, float] = {}

    def __call__(self, step: int, placement: Placement) -> Sequence[Move]:
        """Return what moves after a step."""
        if restarts := self._fail_over(step, placement):
            return restarts
        costs, now = self._costs, step * STEP
        short = costs.short[:, costs.index(placement)]
        has_lasted = step > 0 and short[step] > 0 and short[step - 1] > 0
        if not has_lasted or now < self._rests_until:
            return ()
        moves = _moves(placement, self._solve(step, placement))
        best = costs.index(after(placement, moves))
        gain = (short[step] - costs.short[step, best]) * HORIZON
        if not moves or gain <= sum(costs.move[step, i] for i, _ in moves):
            return ()
        self._rests_until = now + self._rest
        self._rest = min(2 * self._rest, LONGEST_REST)
        self._away |= {(i, placement[i]): now + STAY_AWAY for i, _ in moves}
        return moves

    def _solve(self, step: int, placement: Placement) -> Placement:
        """Return a placement that keeps all limits; where there is none, the same."""
        trace, now = self._costs.trace, step * STEP
        reach = [int(h) for h in np.flatnonzero(~trace.lost[step])]
        placed = [i for i, computer in enumerate(placement) if computer in reach]
        items = tuple(
            Item(
                name=f"{i}",
                demand={"cpu": float(trace.demands[step, i])},
                only=tuple(
                    f"{h}"
                    for h in (reach if trace.pins[i] is None else [placement[i]])
                    if h == placement[i] or self._away.get((i, h), 0.0) <= now
                ),
                present=f"{placement[i]}",
                move_cost=0.001,
            )
            for i in placed
        )
        computers = tuple(
            Computer(name=f"{h}", capacity={"cpu": float(trace.left[step, h])})
            for h in reach
        )
        problem = Problem(components=items, computers=computers)
        found = solve(problem, steps=SOLVE_STEPS, why=False)
        if not found.feasible:
            return placement
        where = {int(i): int(h) for i, h in found.placement.items()}
        return tuple(where.get(i, computer) for i, computer in enumerate(placement))


def _moves(placement: Placement, then: Placement) -> Sequence[Move]:
    return [(i, h) for i, h in enumerate(then) if h != placement[i]]
