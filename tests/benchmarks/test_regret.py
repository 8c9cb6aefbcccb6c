"""The oracle that rules are compared with is right, and what is compared with it."""

from __future__ import annotations

from itertools import product
from random import Random

import numpy as np
import pytest

from benchmarks.regret.costs import DOWNTIME, START, Costs, follow
from benchmarks.regret.loop import Loop
from benchmarks.regret.oracle import oracle
from benchmarks.regret.rules import Total, ahead, never
from benchmarks.regret.summary import RULES, compare
from benchmarks.regret.traces import KINDS, STEP, Placement, Trace, trace


def happens(
    demands: list[list[float]],
    background: list[list[float]],
    start: Placement,
    pins: tuple[int | None, ...] = (),
    lost: tuple[tuple[int, int], ...] = (),
) -> Trace:
    """Return what happens to three computers of one core; `lost`: steps, computers."""
    is_lost = np.zeros((len(demands), 3), dtype=bool)
    for step, computer in lost:
        is_lost[step, computer] = True
    return Trace(
        kind="made up",
        seed=0,
        capacity=np.ones(3),
        demands=np.array(demands),
        background=np.array(background),
        lost=is_lost,
        pins=pins or (None,) * len(start),
        start=start,
    )


def cost(trace: Trace, placements: tuple[Placement, ...]) -> float:
    """Return what a placement in each step costs, counted one by one."""
    total = 0.0
    before = trace.start
    for step, placement in enumerate(placements):
        for computer in range(3):
            has = max(0.0, 1.0 - trace.background[step][computer])
            if trace.lost[step][computer]:
                has = 0.0
            here = (i for i, at in enumerate(placement) if at == computer)
            total += STEP * max(0.0, sum(trace.demands[step][i] for i in here) - has)
        for i, (one, other) in enumerate(zip(before, placement, strict=True)):
            if one != other:
                total += START + DOWNTIME * trace.demands[step][i]
        before = placement
    return total


def tiny(seed: int) -> Trace:
    """Return three components, one of them pinned or not, for four steps."""
    chance = Random(seed)
    pins = (chance.choice([None, 0, 1, 2]), None, None if seed % 5 == 0 else 2)
    start = tuple(chance.randrange(3) if pin is None else pin for pin in pins)
    return happens(
        [[chance.uniform(0, 1.5) for _ in range(3)] for _ in range(4)],
        [[chance.choice([0.0, 0.3, 1.2]) for _ in range(3)] for _ in range(4)],
        start,
        pins,
        ((2, 0), (3, 0)) if seed % 2 else (),
    )


@pytest.mark.parametrize("seed", range(10))
def test_the_oracle_costs_what_the_best_of_all_sequences_costs(seed: int) -> None:
    trace = tiny(seed)
    choices = [range(3) if pin is None else (pin,) for pin in trace.pins]
    later = product([*product(*choices)], repeat=3)
    best = min(cost(trace, (trace.start, *placements)) for placements in later)
    assert oracle(Costs(trace)).cost == pytest.approx(best)


def test_the_oracle_moves_before_a_load_comes_that_outweighs_it() -> None:
    idle, busy = [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]
    trace = happens([[0.5]] * 6, [idle, idle, busy, busy, busy, busy], (0,))
    # 4 steps x 0.5 s x 0.5 cores are 1; a move is 0.3 + 0.05 s x 0.5 cores
    found = oracle(Costs(trace))
    assert found.cost == pytest.approx(0.325)
    assert (found.short, found.moves) == (0.0, 1)
    assert follow(Costs(trace), never(Costs(trace))).cost == pytest.approx(1.0)


def test_the_oracle_bears_a_load_that_is_not_worth_a_move() -> None:
    trace = happens([[0.5]] * 3, [[0.0] * 3, [1.0, 0.0, 0.0], [0.0] * 3], (0,))
    found = oracle(Costs(trace))
    assert found.cost == pytest.approx(0.25)
    assert found.moves == 0


def test_what_a_lost_computer_ran_restarts_a_step_later_with_every_rule() -> None:
    trace = happens([[0.1, 0.2]] * 4, [[0.0] * 3] * 4, (0, 1), lost=((1, 0), (2, 0)))
    costs = Costs(trace)
    for rule in (never(costs), ahead(costs, 1.0), Total(costs), Loop(trace)):
        found = follow(costs, rule)
        # 0.5 s x 0.1 cores do not run; the start is 0.3 + 0.05 s x 0.1 cores
        assert found.cost == pytest.approx(0.05 + 0.305)
        assert found.moves == 1


def test_the_real_loop_moves_the_simulated_robot() -> None:
    calm, busy = [0.0] * 3, [0.9, 0.0, 0.0]
    trace = happens([[0.3, 0.3]] * 60, [calm] * 10 + [busy] * 50, (0, 1))
    costs, loop = Costs(trace), Loop(trace)
    found = follow(costs, loop)
    assert loop.acts
    # 50 steps x 0.5 s x 0.2 cores
    assert follow(costs, never(costs)).cost == pytest.approx(5.0)
    assert found.cost < 2.5


@pytest.mark.parametrize("loads", [(0.4, 0.6), (0.6, 0.8)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_trace_has_the_load_that_was_asked(
    kind: str, loads: tuple[float, float]
) -> None:
    low, high = loads
    for seed in range(3):
        assert low - 0.001 <= trace(kind, seed, loads).load <= high + 0.001


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_comparison_can_be_repeated(kind: str) -> None:
    first, second = (compare(trace(kind, 1, (0.6, 0.8))) for _ in range(2))
    assert first == second
    assert first.outcomes.keys() == {"oracle", "poise", *RULES}
