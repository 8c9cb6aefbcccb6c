"""Compares ways to place by pairs of runs, as `criteria.md` says. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations_with_replacement
from statistics import median
from typing import Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from scipy import stats

from benchmarks.experiment.results import TrialResult

SUBJECT = "Poise"
_EQUAL = 0.05
"""Differences of the share missed up to this one are of no importance."""
_ALPHA = 0.05
_RESAMPLES = 10_000
_SPEED = 0.10
"""A machine whose speed is further from the median of the series is another one."""
_LEAST = 6
"""With fewer pairs, no outcome of the test could reach `_ALPHA`."""

Verdict = Literal["better", "worse", "as good", "undecided", "not measured"]


class Comparison(Struct, frozen=True, kw_only=True):
    """Poise against another way to place, under a condition.

    Parameters
    ----------
    pairs
        Seeds of which both have a valid run.
    effect, low, high
        Share of the worst chain's deadlines missed, Poise minus the other: the
        Hodges-Lehmann estimate and its interval of 95 %; None without pairs.
    p
        Of Wilcoxon's signed-rank test, adjusted by Holm; None with too few pairs.
    """

    condition: str
    other: str
    pairs: int
    effect: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None
    verdict: Verdict = "not measured"


def worst_chain(result: TrialResult) -> float | None:
    """Return the largest share of a chain's deadlines missed; None: no chain.

    A chain whose data never arrived counts as missed.
    """
    shares = [c.missed / c.of if c.of else 1.0 for c in result.chains.values()]
    return max(shares, default=None)


def voided(results: Sequence[TrialResult]) -> list[TrialResult]:
    """Return the results; invalid too is what another speed of the machine shaped."""
    speeds = [speed for each in results if not each.invalid for speed in each.speeds]
    if not speeds:
        return list(results)
    usual = median(speeds)

    def judged(result: TrialResult) -> TrialResult:
        off = max((abs(speed / usual - 1) for speed in result.speeds), default=0.0)
        if result.invalid or off <= _SPEED:
            return result
        why = f"the machine's speed was {off:.0%} off the median of the series"
        return replace(result, invalid=why)

    return [judged(each) for each in results]


def compared(
    results: Iterable[TrialResult], arms: Sequence[str], conditions: Sequence[str]
) -> tuple[Comparison, ...]:
    """Return Poise against each other way under each condition."""
    measured: dict[tuple[str, str], dict[int, float]] = {}
    runs: dict[tuple[str, str], list[bool]] = {}
    for result in results:
        key = result.trial.condition, result.trial.arm
        runs.setdefault(key, []).append(not result.invalid)
        share = worst_chain(result)
        if not result.invalid and share is not None:
            measured.setdefault(key, {})[result.trial.seed] = share
    found = [
        _comparison(
            condition,
            arm,
            measured.get((condition, SUBJECT), {}),
            measured.get((condition, arm), {}),
            enough=all(_is_measured(runs.get((condition, a), [])) for a in _pair(arm)),
        )
        for condition in conditions
        for arm in arms
        if arm != SUBJECT
    ]
    return tuple(map(_judged, _holm(found)))


def _pair(arm: str) -> tuple[str, str]:
    return SUBJECT, arm


def _is_measured(valid: Sequence[bool]) -> bool:
    """Return whether no more than a third of the runs are invalid."""
    return bool(valid) and 3 * valid.count(False) <= len(valid)


def _comparison(
    condition: str,
    other: str,
    ours: Mapping[int, float],
    theirs: Mapping[int, float],
    *,
    enough: bool,
) -> Comparison:
    seeds = sorted(ours.keys() & theirs.keys())
    pairs = Comparison(condition=condition, other=other, pairs=len(seeds))
    if not seeds or not enough:
        return pairs
    differences = np.array([ours[seed] - theirs[seed] for seed in seeds])
    low, high = _interval(differences)
    return replace(
        pairs, effect=hodges_lehmann(differences), low=low, high=high, p=_p(differences)
    )


def hodges_lehmann(differences: Sequence[float] | np.ndarray) -> float:
    """Return the median of the means of all pairs (Hodges and Lehmann 1963)."""
    pairs = combinations_with_replacement(map(float, differences), 2)
    return median((a + b) / 2 for a, b in pairs)


def _interval(differences: np.ndarray) -> tuple[float, float]:
    """Return the bootstrap interval of 95 % (percentiles) of the estimate."""
    chance = np.random.default_rng(0)
    one, other = np.triu_indices(len(differences))
    estimates = []
    for _ in range(_RESAMPLES):
        drawn = chance.choice(differences, len(differences))
        estimates.append(np.median((drawn[one] + drawn[other]) / 2))
    low, high = np.percentile(estimates, [2.5, 97.5])
    return float(low), float(high)


def _p(differences: np.ndarray) -> float | None:
    if len(differences) < _LEAST:
        return None
    if not differences.any():
        return 1.0
    tested = stats.wilcoxon(differences, zero_method="zsplit", method="approx")
    return float(tested.pvalue)


def _holm(found: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons with p-values for all of them together (Holm 1979)."""
    tested = sorted((c for c in found if c.p is not None), key=lambda c: c.p or 0.0)
    adjusted: dict[tuple[str, str], float] = {}
    highest = 0.0
    for rank, each in enumerate(tested):
        highest = min(1.0, max(highest, (len(tested) - rank) * (each.p or 0.0)))
        adjusted[each.condition, each.other] = highest
    return [replace(e, p=adjusted.get((e.condition, e.other))) for e in found]


def _judged(found: Comparison) -> Comparison:
    if found.low is None or found.high is None:
        return found
    verdict: Verdict = "undecided"
    if found.low >= -_EQUAL and found.high <= _EQUAL:
        verdict = "as good"
    elif found.p is not None and found.p < _ALPHA and found.high < -_EQUAL:
        verdict = "better"
    elif found.p is not None and found.p < _ALPHA and found.low > _EQUAL:
        verdict = "worse"
    return replace(found, verdict=verdict)


def headline(comparisons: Sequence[Comparison]) -> str:
    """Return in a sentence whether Poise wins, and against whom it does not."""
    decided = [each for each in comparisons if each.verdict != "not measured"]
    if not decided:
        return "Nothing is decided: no condition has enough valid pairs of runs."
    conditions = dict.fromkeys(each.condition for each in decided)
    won = [c for c in conditions if _wins([e for e in decided if e.condition == c])]
    if len(won) == len(conditions):
        return f"Poise wins under all of {len(won)} conditions."
    rivals = dict.fromkeys(
        f"{e.other} ({e.condition}: {e.verdict})"
        for e in decided
        if e.condition not in won and e.verdict in {"as good", "worse", "undecided"}
    )
    where = f"wins under {', '.join(won)} only" if won else "does not win"
    return f"Poise {where}. Not beaten: {', '.join(rivals)}."


ON_PAPER = frozenset({"whole functions", "greedy", "least allocated"})
"""Ways that look at limits: to beat one of these is what the objective is worth."""


def _wins(found: Sequence[Comparison]) -> bool:
    verdicts = {each.other: each.verdict for each in found}
    beaten = [name for name, verdict in verdicts.items() if verdict == "better"]
    return set(verdicts.values()) <= {"better", "as good"} and bool(
        ON_PAPER.intersection(beaten)
    )
