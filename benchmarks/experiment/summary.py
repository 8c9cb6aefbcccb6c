"""What the runs of each arm showed together. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean, median
from typing import TypeVar

from msgspec import Struct

from benchmarks.experiment.analysis import Comparison
from benchmarks.experiment.results import Missed, TrialResult

V = TypeVar("V")
_Z = 1.959963984540054
"""The normal quantile of a two-sided interval of 95 %."""


class Share(Struct, frozen=True, kw_only=True):
    """How often something held, with Wilson's interval of 95 %.

    `share` is None when there was no valid run.
    """

    share: float | None
    low: float
    high: float
    of: int

    def __str__(self) -> str:
        """Return it for people."""
        if self.share is None:
            return "no valid run"
        return f"{self.share:.0%} ({self.low:.0%} to {self.high:.0%})"


class ArmSummary(Struct, frozen=True, kw_only=True):
    """The runs of one arm under one condition.

    Parameters
    ----------
    placement
        The arm's name.
    runs, invalid
        How many were made, and how many of these say nothing about the robot; nothing
        else counts them.
    success
        Function -> how often it worked, over the runs in which the world judged it.
    all_worked
        How often all functions did that it judged.
    deadline_miss_share
        Chain -> share of the uses of its data that came too late, over all runs; None
        when its data never came to its end.
    timer_miss_share
        ``component.timer`` -> share of the deadlines missed, over all runs.
    ages, ages_p99
        Chain -> age of its data when used [s]: the median over the runs, whose timers
        have phases of their own, of the median and of the 99th percentile of each.
    path_error, decision_seconds, moves
        Medians over the runs [m], [s], and a count.
    cpu_share
        Computer -> share of its CPU used, in the mean.
    suspended
        Architecture -> in how many runs it did not run, because not all fits.
    """

    placement: str
    condition: str
    runs: int
    invalid: int
    success: Mapping[str, Share]
    all_worked: Share
    deadline_miss_share: Mapping[str, float | None]
    timer_miss_share: Mapping[str, float | None]
    ages: Mapping[str, float | None]
    ages_p99: Mapping[str, float | None]
    path_error: float | None
    decision_seconds: float | None
    moves: float | None
    cpu_share: Mapping[str, float]
    suspended: Mapping[str, int]


class ExperimentReport(Struct, frozen=True, kw_only=True):
    """What the experiment found.

    Parameters
    ----------
    arms
        Each arm under each condition; the robot file's own condition first.
    seconds
        How long each run was measured [s].
    planned
        How many runs were to be made.
    comparisons, headline
        Poise against each other way by the criteria, and that in a sentence.
    criteria
        The commit of the criteria and its date; empty: it is not known.
    """

    robot: str
    seconds: float
    planned: int
    arms: tuple[ArmSummary, ...]
    comparisons: tuple[Comparison, ...] = ()
    headline: str = ""
    criteria: str = ""


def wilson(held: int, of: int) -> Share:
    """Return the share of `of` that held, with Wilson's score interval of 95 %."""
    if not of:
        return Share(share=None, low=0.0, high=1.0, of=0)
    share, z2 = held / of, _Z * _Z
    centre = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = _Z * math.sqrt(share * (1 - share) / of + z2 / (4 * of * of)) / (1 + z2 / of)
    low = 0.0 if not held else max(0.0, centre - half)
    high = 1.0 if held == of else min(1.0, centre + half)
    return Share(share=share, low=low, high=high, of=of)


def summarised(
    results: Iterable[TrialResult],
    arms: Sequence[str],
    conditions: Sequence[str],
    functions: Sequence[str],
) -> tuple[ArmSummary, ...]:
    """Return a summary of each arm under each condition, in this order.

    Invalid runs count as such, also of a trial that was made again.

    Parameters
    ----------
    functions
        Those of which it says how often they worked.
    """
    groups: dict[tuple[str, str], list[TrialResult]] = {}
    for result in results:
        key = result.trial.condition, result.trial.arm
        groups.setdefault(key, []).append(result)
    return tuple(
        _summary(arm, condition, groups.get((condition, arm), []), functions)
        for condition in conditions
        for arm in arms
    )


def _summary(
    arm: str, condition: str, runs: Sequence[TrialResult], functions: Sequence[str]
) -> ArmSummary:
    valid = [each for each in runs if not each.invalid]
    chains = _by_name(each.chains for each in valid)
    timers = _by_name(each.timers for each in valid)
    cpu_shares = _by_name(each.cpu_share for each in valid)
    errors = [each.world.get("path_error") for each in valid]
    suspended = [name for each in valid for name in each.suspended]
    return ArmSummary(
        placement=arm,
        condition=condition,
        runs=len(runs),
        invalid=len(runs) - len(valid),
        success={
            name: _held(r.functions[name] for r in valid if name in r.functions)
            for name in functions
        },
        all_worked=_held(all(r.functions.values()) for r in valid if r.functions),
        deadline_miss_share={name: _missed(each) for name, each in chains.items()},
        timer_miss_share={name: _missed(each) for name, each in timers.items()},
        ages={n: _median(m.median for m in each) for n, each in chains.items()},
        ages_p99={n: _median(m.p99 for m in each) for n, each in chains.items()},
        path_error=_median(errors),
        decision_seconds=_median(each.decision_seconds for each in valid),
        moves=_median(each.moves for each in valid),
        cpu_share={name: fmean(shares) for name, shares in cpu_shares.items()},
        suspended={name: suspended.count(name) for name in dict.fromkeys(suspended)},
    )


def _held(outcomes: Iterable[bool]) -> Share:
    known = list(outcomes)
    return wilson(sum(known), len(known))


def _by_name(several: Iterable[Mapping[str, V]]) -> dict[str, list[V]]:
    """Return what several say of each name."""
    found: dict[str, list[V]] = {}
    for each in several:
        for name, value in each.items():
            found.setdefault(name, []).append(value)
    return found


def _missed(counts: Sequence[Missed]) -> float | None:
    of = sum(each.of for each in counts)
    return sum(each.missed for each in counts) / of if of else None


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None
