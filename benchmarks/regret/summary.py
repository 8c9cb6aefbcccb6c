"""All arms on traces of one load band, and what was asked of Poise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import inf
from statistics import mean, median

from msgspec import Struct

from benchmarks.regret.costs import DOWNTIME, START, Costs, Outcome, Rule, follow
from benchmarks.regret.loop import Act, Loop
from benchmarks.regret.oracle import oracle
from benchmarks.regret.rules import HORIZON, Total, ahead, never
from benchmarks.regret.traces import Trace, trace

RULES: Mapping[str, Callable[[Costs], Rule]] = {
    "never": never,
    "greedy": partial(ahead, horizon=1.0),
    "total": Total,
    "horizon": partial(ahead, horizon=HORIZON),
}
ARMS = ("oracle", "poise", *RULES)
_HEAVY = 0.6
"""From this mean load on [share], more is asked of Poise."""
_ALL = 0.99
"""A move that removes this share of the shortage suffices."""
_ROUNDING = 1e-6


class Compared(Struct, frozen=True, kw_only=True):
    """The outcome of every arm on one trace.

    Parameters
    ----------
    one_move
        What the move of the largest component costs at most [core-seconds].
    acts
        How often Poise changed the placement.
    needless
        How often when all components had what they needed.
    simple
        How often when one move would have removed the shortage.
    one_step
        How often one step was taken then.
    """

    kind: str
    seed: int
    load: float
    outcomes: Mapping[str, Outcome]
    one_move: float
    acts: int
    needless: int
    simple: int
    one_step: int

    def ratio(self, arm: str) -> float:
        """Return an arm's cost over the oracle's, both at least that of one move.

        Otherwise hundredths of a core-second, which nobody notices, would decide.
        """
        cost, least = self.outcomes[arm].cost, self.outcomes["oracle"].cost
        return max(cost, self.one_move) / max(least, self.one_move)

    def is_harmful(self, arm: str) -> bool:
        """Return whether never moving is better by more than the cost of a move."""
        costs = self.outcomes
        return costs[arm].cost > costs["never"].cost + self.one_move + _ROUNDING


class ArmSummary(Struct, frozen=True, kw_only=True):
    """One arm on all traces; `cost` is the mean [core-seconds].

    Parameters
    ----------
    moves
        The mean of a trace.
    harmful
        The traces on which it would have been better never to move.
    """

    cost: float
    mean_ratio: float
    median_ratio: float
    worst_ratio: float
    moves: float
    harmful: int


class Target(Struct, frozen=True, kw_only=True):
    """A figure, and the most or least that was asked for."""

    what: str
    value: float
    most: float = inf
    least: float = -inf
    is_met: bool

    @classmethod
    def of(
        cls, what: str, value: float, *, most: float = inf, least: float = -inf
    ) -> Target:
        """Return whether a figure is as asked."""
        is_met = least <= value <= most + _ROUNDING
        return cls(what=what, value=value, most=most, least=least, is_met=is_met)


class Band(Struct, frozen=True, kw_only=True):
    """All arms on traces whose mean load is within `loads` [share of all capacity]."""

    loads: tuple[float, float]
    traces: tuple[Compared, ...]
    arms: Mapping[str, ArmSummary]
    targets: tuple[Target, ...]


def band(loads: tuple[float, float], num_traces: int, kinds: Sequence[str]) -> Band:
    """Return how all arms do; the kinds of traces take turns."""
    found = tuple(
        compare(trace(kinds[seed % len(kinds)], seed, loads))
        for seed in range(num_traces)
    )
    arms = {arm: _summary(arm, found) for arm in ARMS}
    targets = (*_asked(loads, arms), _one_step(found))
    return Band(loads=loads, traces=found, arms=arms, targets=targets)


def compare(happens: Trace) -> Compared:
    """Return the outcome of every arm on a trace."""
    costs, loop = Costs(happens), Loop(happens)
    outcomes = {
        "oracle": oracle(costs),
        "poise": follow(costs, loop),
        **{name: follow(costs, rule(costs)) for name, rule in RULES.items()},
    }
    least = outcomes["oracle"].cost
    for arm, outcome in outcomes.items():
        assert outcome.cost >= least - _ROUNDING, (happens.kind, happens.seed, arm)
    simple = [act for act in loop.acts if _one_suffices(costs, act)]
    return Compared(
        kind=happens.kind,
        seed=happens.seed,
        load=happens.load,
        outcomes=outcomes,
        one_move=START + DOWNTIME * float(happens.demands.max()),
        acts=len(loop.acts),
        needless=sum(_short(costs, act) <= _ROUNDING for act in loop.acts),
        simple=len(simple),
        one_step=sum(act.num_steps == 1 for act in simple),
    )


def _short(costs: Costs, act: Act) -> float:
    """Return what was short when Poise acted [cores]."""
    return float(costs.short[act.step, costs.index(act.placement)])


def _one_suffices(costs: Costs, act: Act) -> bool:
    short = _short(costs, act)
    left = (costs.short[act.step, i] for i in costs.neighbours(act.step, act.placement))
    return short > _ROUNDING and min(left, default=inf) <= (1 - _ALL) * short


def _summary(arm: str, found: Sequence[Compared]) -> ArmSummary:
    ratios = [each.ratio(arm) for each in found]
    return ArmSummary(
        cost=mean(each.outcomes[arm].cost for each in found),
        mean_ratio=mean(ratios),
        median_ratio=median(ratios),
        worst_ratio=max(ratios),
        moves=mean(each.outcomes[arm].moves for each in found),
        harmful=sum(each.is_harmful(arm) for each in found),
    )


def _asked(
    loads: tuple[float, float], arms: Mapping[str, ArmSummary]
) -> Sequence[Target]:
    poise = arms["poise"]
    if loads[0] < _HEAVY:
        most = arms["total"].cost
        return [Target.of("mean cost, at most that of total", poise.cost, most=most)]
    most = 2.5 * arms["oracle"].cost
    return [
        Target.of("mean cost, at most 2.5 times the oracle's", poise.cost, most=most),
        Target.of("median ratio", poise.median_ratio, most=2.0),
        Target.of("worst ratio", poise.worst_ratio, most=20.0),
        Target.of("traces where never moving is better", poise.harmful, most=0),
    ]


def _one_step(found: Sequence[Compared]) -> Target:
    simple = sum(each.simple for each in found)
    share = sum(each.one_step for each in found) / simple if simple else 1.0
    return Target.of("one step where one suffices, share", share, least=0.95)
