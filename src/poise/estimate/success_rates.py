"""How often actions succeed with an architecture, learned from their outcomes.

Success drifts and jumps, so late outcomes count for more and a change ends what was
before it (Raj and Kalyani 2017, "Taming Non-stationary Bandits", discounted Thompson
sampling; Besson et al. 2022, "Efficient Change-Point Detection for Tackling Piecewise-
Stationary Bandits", the Bernoulli GLR test, with a restart of all alternatives).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import log, sqrt
from pathlib import Path
from random import Random
from statistics import fmean
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import UsageError, unknown
from poise.estimate.code_version import hash_of
from poise.estimate.profiles import SqliteFile
from poise.model.robot import Architecture, Robot
from poise.model.steps import Action

STORE = Path(".poise") / "success.sqlite"
DISCOUNT = 0.98
"""What an outcome counts for after each later one: the last 50 count most."""
FALSE_ALARM = 0.05
"""How often the test may find a change where there is none."""
KEPT = 400
"""Outcomes that are kept of an action: the next one would count for 0.0003."""
Ending = Literal["done", "failed"]
"""How an action ended."""
_SCHEMA = """
CREATE TABLE IF NOT EXISTS outcomes (
    id INTEGER PRIMARY KEY, robot TEXT NOT NULL, at REAL NOT NULL, action TEXT NOT NULL,
    situation TEXT NOT NULL, function TEXT NOT NULL, architecture TEXT NOT NULL,
    hash TEXT NOT NULL, ending TEXT NOT NULL
)
"""


class Conditions(Struct, frozen=True, kw_only=True):
    """What is known of the circumstances of an action; each is learned apart.

    Parameters
    ----------
    lost
        The computers that were out of reach, by name.
    cpu_is_short
        Whether components wanted more CPU than their computers have.
    """

    lost: tuple[str, ...] = ()
    cpu_is_short: bool = False

    def __post_init__(self) -> None:
        """Sort the computers: their order means nothing."""
        msgspec.structs.force_setattr(self, "lost", tuple(sorted({*self.lost})))

    def __str__(self) -> str:
        """Return it for people."""
        lost = f"without {', '.join(self.lost)}" if self.lost else "all computers"
        return f"{lost}, CPU short" if self.cpu_is_short else lost


WELL = Conditions()
"""All computers are there, and the CPU is not short."""


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


Alternative = tuple[str, str]
"""An architecture and its hash."""


def rates(
    outcomes: Sequence[tuple[Alternative, bool]],
) -> dict[Alternative, SuccessRate]:
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


def note_outcome(
    robot: Robot,
    action: str,
    ending: Ending,
    architectures: Mapping[str, str] | Iterable[str],
    *,
    conditions: Conditions = WELL,
) -> None:
    """Note how an action ended, so that the next choice of architectures knows.

    Parameters
    ----------
    robot
        As `poise.load` returns it; its folder keeps the outcomes.
    action, ending
        The name of the action, and ``done`` or ``failed``.
    architectures
        What served the action: `Placement.architectures`, of which those count whose
        function the action needs; or names of architectures, which all count.
    conditions
        What was known of the circumstances.

    Raises
    ------
    UsageError
        The robot has no such action or architecture, or is from no file; or there is
        no such ending.
    """
    functions = {a.name: a.functions for a in robot.actions()}
    if action not in functions:
        raise UsageError(unknown("action", action, functions))
    if ending not in ("done", "failed"):
        raise UsageError(f"ending is {ending!r}: it is 'done' or 'failed'")
    if isinstance(architectures, Mapping):
        needed = functions[action]
        architectures = [name for f, name in architectures.items() if f in needed]
    served = [_named(robot, name) for name in architectures]
    situation = msgspec.json.encode(conditions).decode()
    with _store(robot) as store:
        for a in served:
            key = robot.name, a.function, action, situation
            store.execute(
                "INSERT INTO outcomes (robot, function, action, situation, at,"
                " architecture, hash, ending) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                *(*key, wall_time(), a.name, hash_of(a, robot.folders), ending),
            )
            same = "robot = ? AND function = ? AND action = ? AND situation = ?"
            store.execute(
                f"DELETE FROM outcomes WHERE {same} AND id NOT IN (SELECT id FROM"  # noqa: S608 - a constant
                f" outcomes WHERE {same} ORDER BY id DESC LIMIT {KEPT})",
                *(*key, *key),
            )


def learned(
    robot: Robot,
    actions: Iterable[Action],
    *,
    conditions: Conditions = WELL,
    explore: bool = False,
    seed: int = 0,
) -> Learned:
    """Return the robot with learned success: the mean over actions of a function."""
    explore, actions = explore or robot.explore, tuple(actions)
    groups: dict[str, list[Architecture]] = {}
    for a in robot.architectures:
        if a.layer == "sequencing":
            groups.setdefault(a.function, []).append(a)
    success: dict[str, float] = {}
    says = []
    for function, group in groups.items():
        needing = dict.fromkeys(a.name for a in actions if function in a.functions)
        known, last = _rates_for(robot, function)
        if len(group) == 1 or not needing or not (known or explore):
            continue
        by_action = [known.get((name, conditions), {}) for name in needing]
        keys = [(a.name, hash_of(a, robot.folders)) for a in group]
        if not explore and not any(key in of for of in by_action for key in keys):
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


def beliefs_about(robot: Robot, architecture: str) -> list[Belief]:
    """Return what was learned of an architecture, by action, conditions and hash."""
    this = _named(robot, architecture)
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
        for (action, conditions), of in _rates_for(robot, this.function)[0].items()
        for (name, hash_), rate in of.items()
        if name == architecture
    ]


def forget(robot: Robot, architecture: str) -> int:
    """Forget what was learned of an architecture; return the number of outcomes."""
    _named(robot, architecture)
    if not _has_outcomes(robot):
        return 0
    with _store(robot) as store:
        return store.execute(
            "DELETE FROM outcomes WHERE robot = ? AND architecture = ?",
            *(robot.name, architecture),
        ).rowcount


def _named(robot: Robot, name: str) -> Architecture:
    names = [a.name for a in robot.architectures]
    if name not in names:
        raise UsageError(unknown("architecture", name, names))
    return robot.architecture(name)


def _rates_for(
    robot: Robot, function: str
) -> tuple[dict[tuple[str, Conditions], dict[Alternative, SuccessRate]], int]:
    """Return (action, conditions) -> success of alternatives; and the last outcome."""
    outcomes: dict[tuple[str, str], list[tuple[Alternative, bool]]] = {}
    last = 0
    if _has_outcomes(robot):
        with _store(robot) as store:
            rows = store.execute(
                "SELECT id, action, situation, architecture, hash, ending FROM outcomes"
                " WHERE robot = ? AND function = ? ORDER BY id",
                *(robot.name, function),
            )
            for last, action, situation, name, hash_, ending in rows:  # noqa: B007
                of = outcomes.setdefault((action, situation), [])
                of.append(((name, hash_), ending == "done"))
    return {
        (action, msgspec.json.decode(situation, type=Conditions)): rates(of)
        for (action, situation), of in outcomes.items()
    }, last


def _has_outcomes(robot: Robot) -> bool:
    return bool(robot.folder) and (Path(robot.folder) / STORE).exists()


def _store(robot: Robot) -> SqliteFile:
    if not robot.folder:
        raise UsageError(
            f"robot '{robot.name}' is from no file, so there is no folder to keep "
            "outcomes in: load it with `poise.load`, or set its `folder`"
        )
    return SqliteFile(Path(robot.folder) / STORE, _SCHEMA, "outcomes of actions")
