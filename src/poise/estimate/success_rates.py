"""How often actions succeed with an architecture, learned from their outcomes.

Success drifts and jumps, so late outcomes count for more and a change ends what was
before it (Raj and Kalyani 2017, "Taming Non-stationary Bandits", discounted Thompson
sampling; Besson et al. 2022, "Efficient Change-Point Detection for Tackling Piecewise-
Stationary Bandits", the Bernoulli GLR test, with a restart of all alternatives).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import log, sqrt
from random import Random
from statistics import fmean
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from poise.estimate.code_version import hash_of
from poise.estimate.outcomes import (
    WELL,
    Alternative,
    Conditions,
    Outcome,
    named_architecture,
    outcomes_of,
)
from poise.model.robot import Architecture, Robot
from poise.model.steps import Action

DISCOUNT = 0.98
"""What an outcome counts for after each later one: the last 50 count most."""
FALSE_ALARM = 0.05
"""How often the test may find a change where there is none."""


class SuccessRate(NamedTuple):
    """A success rate, believed to be Beta(1 + done, 1 + failed), counts discounted."""

    done: float = 0.0
    failed: float = 0.0

    @property
    def mean(self) -> float:
        """The expected success rate, in (0, 1)."""
        return (self.done + 1) / (self.done + self.failed + 2)

    @property
    def deviation(self) -> float:
        """The standard deviation of the success rate."""
        return sqrt(self.mean * (1 - self.mean) / (self.done + self.failed + 3))

    def sample(self, random: Random) -> float:
        """Return a rate drawn from the belief, as Thompson sampling does; above 0."""
        return max(random.betavariate(self.done + 1, self.failed + 1), 1e-9)


class Belief(Struct, frozen=True, kw_only=True):
    """What is believed of the success of an action with an architecture.

    Parameters
    ----------
    hash
        Of the architecture as it ran.
    is_present
        Whether this is its hash now: only such outcomes count.
    done, failed
        Outcomes since the last change; earlier ones count for less.
    mean, deviation
        Of the success rate.
    """

    action: str
    conditions: Conditions
    hash: str
    is_present: bool
    done: float
    failed: float
    mean: float
    deviation: float


class Learned(NamedTuple):
    """A robot whose alternatives know their success, and sentences about it."""

    robot: Robot
    says: tuple[str, ...] = ()


def rates(outcomes: Sequence[Outcome]) -> dict[Alternative, SuccessRate]:
    """Return the success of alternatives after these outcomes of one action."""
    start = 0
    for alternative in {one for one, _ in outcomes}:
        at = [i for i, (one, _) in enumerate(outcomes) if one == alternative]
        if change := change_point([outcomes[i][1] for i in at]):
            start = max(start, at[change])
    counts: dict[Alternative, SuccessRate] = {}
    for age, (alternative, done) in enumerate(reversed(outcomes[start:])):
        rate, weight = counts.get(alternative, SuccessRate()), DISCOUNT**age
        counts[alternative] = SuccessRate(
            rate.done + weight * done, rate.failed + weight * (not done)
        )
    return counts


def change_point(endings: Sequence[bool]) -> int:
    """Return the first ending after a change of the rate, or 0."""
    n, total, before = len(endings), sum(endings), 0
    strongest, at = log(n**1.5 / FALSE_ALARM) if n else 0.0, 0
    for i in range(1, n):
        before += endings[i - 1]
        evidence = i * _kl(before / i, total / n)
        evidence += (n - i) * _kl((total - before) / (n - i), total / n)
        if evidence > strongest:
            strongest, at = evidence, i
    return at


def _kl(p: float, q: float) -> float:
    """Return the Kullback-Leibler divergence of two success rates."""
    return sum(a * log(a / b) for a, b in ((p, q), (1 - p, 1 - q)) if a > 0)


def learned(
    robot: Robot,
    actions: Iterable[Action],
    *,
    conditions: Conditions = WELL,
    explore: bool = False,
    seed: int = 0,
    compares: bool = False,  # with others: what has no alternative counts as well
) -> Learned:
    """Return the robot with learned success: the mean over actions of a function."""
    explore, actions = explore or robot.explore, tuple(actions)
    wants_untried = explore or compares
    groups: dict[str, list[Architecture]] = {}
    for a in robot.architectures:
        if a.layer == "sequencing":
            groups.setdefault(a.function, []).append(a)
    success: dict[str, float] = {}
    says = []
    for function, group in groups.items():
        needing = dict.fromkeys(a.name for a in actions if function in a.functions)
        if not needing or (len(group) == 1 and not compares):
            continue
        noted, last = outcomes_of(robot, function)
        known = {circumstances: rates(of) for circumstances, of in noted.items()}
        if not (known or wants_untried):
            continue
        by_action = [known.get((name, conditions), {}) for name in needing]
        keys = [(a.name, hash_of(a, robot.folders)) for a in group]
        is_known = any(key in of for of in by_action for key in keys)
        if not (is_known or wants_untried):
            continue
        parts = []
        for key in keys:
            beliefs = [of.get(key, SuccessRate()) for of in by_action]
            random = Random(f"{seed} {last} {key[0]}")  # noqa: S311 - no secret
            drawn = [b.sample(random) if explore else b.mean for b in beliefs]
            success[key[0]] = fmean(drawn)
            error = sqrt(sum(b.deviation**2 for b in beliefs)) / len(beliefs)
            parts.append(
                f"'{key[0]}' {fmean(b.mean for b in beliefs):.0%} ± {error:.0%}"
            )
            parts[-1] += f", drawn {success[key[0]]:.0%}" if explore else ""
        says.append(f"success learned for {function}: {'; '.join(parts)}")
    changed = (
        replace(a, success=success.get(a.name, a.success)) for a in robot.architectures
    )
    return Learned(replace(robot, architectures=tuple(changed)), tuple(says))


def with_success(
    robot: Robot, actions: Iterable[Action], conditions: Conditions = WELL
) -> Robot:
    """Return the robot with how often these actions succeed, where that was learned.

    Of an action's functions the one that succeeds least often counts, with the best
    architecture for it.
    """
    actions = tuple(actions)
    functions = dict.fromkeys(f for action in actions for f in action.functions)
    noted = {function: outcomes_of(robot, function)[0] for function in functions}
    success: dict[str, float] = {}
    for action, function in ((a, f) for a in actions for f in a.functions):
        known = rates(noted[function].get((action.name, conditions), []))
        if not known:
            continue
        group = [a for a in robot.architectures if a.function == function]
        of = [known.get((a.name, hash_of(a, robot.folders))) for a in group]
        if any(of):
            means = [(rate or SuccessRate()).mean for rate in of]
            best = max((a.quality * m, m) for a, m in zip(group, means, strict=True))[1]
            success[action.name] = min(best, success.get(action.name, best))
    return replace(robot, success=success)


def as_learned(robot: Robot, tasks: Iterable[str]) -> Robot:
    """Return the robot with all that was learned of the actions of tasks."""
    actions = tuple(action for name in tasks for action in robot.actions(name))
    return with_success(learned(robot, actions).robot, actions)


def is_tried(robot: Robot, action: Action, conditions: Conditions) -> bool:
    """Return whether it is known how an action ended with what provides it now."""
    tried = {
        alternative
        for function in action.functions
        for alternative, _ in outcomes_of(robot, function)[0].get(
            (action.name, conditions), ()
        )
    }
    names = {name for name, _ in tried}
    return any(
        (a.name, hash_of(a, robot.folders)) in tried
        for a in robot.architectures
        if a.name in names
    )


def beliefs_about(robot: Robot, architecture: str) -> list[Belief]:
    """Return what was learned of an architecture, by action, conditions and hash."""
    this = named_architecture(robot, architecture)
    return [
        Belief(
            action=action,
            conditions=conditions,
            hash=hash_,
            is_present=hash_ == hash_of(this, robot.folders),
            done=rate.done,
            failed=rate.failed,
            mean=rate.mean,
            deviation=rate.deviation,
        )
        for (action, conditions), of in outcomes_of(robot, this.function)[0].items()
        for (name, hash_), rate in rates(of).items()
        if name == architecture
    ]
