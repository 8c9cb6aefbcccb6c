"""All outcomes of a robot's actions, in an SQLite file beside the robot file."""

from __future__ import annotations

from math import exp, fsum, lgamma, log, log1p, sqrt
from pathlib import Path
from random import Random
from typing import Literal

import msgspec
from msgspec import Struct

from poise.estimate.sqlite_file import SqliteFile

_STEPS = 40
"""Halvings of an interval: far below what is shown."""


class Posterior(Struct, frozen=True):
    """The belief about a success rate, from the uniform prior Beta(1, 1).

    It is Beta(1 + `done`, 1 + `failed`), the conjugate of independent outcomes of one
    rate (Agrawal and Goyal 2012, algorithm 1).
    """

    done: int = 0  # done, failed: How many outcomes there were of each kind
    failed: int = 0

    @property
    def count(self) -> int:
        """How many outcomes it is learned from."""
        return self.done + self.failed

    @property
    def mean(self) -> float:
        """The expected success rate, in (0, 1)."""
        return (self.done + 1) / (self.count + 2)

    @property
    def deviation(self) -> float:
        """The standard deviation of the success rate."""
        return sqrt(self.mean * (1 - self.mean) / (self.count + 3))

    def interval(self, share: float = 0.9) -> tuple[float, float]:
        """Return the limits between which the rate is with this probability.

        As much lies below the lower limit as above the upper one.
        """
        return self._quantile((1 - share) / 2), self._quantile((1 + share) / 2)

    def sample(self, random: Random) -> float:
        """Return a rate drawn from the belief, as Thompson sampling does; above 0."""
        return max(random.betavariate(self.done + 1, self.failed + 1), 1e-9)

    def below(self, rate: float) -> float:
        """Return the probability that the success rate is at most `rate`.

        With whole parameters this is a tail of the binomial distribution.
        """
        if not 0 < rate < 1:
            return float(rate >= 1)
        n = self.count + 1
        ways, hit, miss = lgamma(n + 1), log(rate), log1p(-rate)
        return fsum(
            exp(ways - lgamma(k + 1) - lgamma(n - k + 1) + k * hit + (n - k) * miss)
            for k in range(self.done + 1, n + 1)
        )

    def _quantile(self, probability: float) -> float:
        low, high = 0.0, 1.0
        for _ in range(_STEPS):
            middle = (low + high) / 2
            if self.below(middle) < probability:
                low = middle
            else:
                high = middle
        return (low + high) / 2


Ending = Literal["done", "failed"]
"""How an action ended."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS outcomes (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    at REAL NOT NULL,           -- seconds since the epoch
    action TEXT NOT NULL,
    situation TEXT NOT NULL,    -- JSON of a Conditions
    function TEXT NOT NULL,
    architecture TEXT NOT NULL,
    hash TEXT NOT NULL,         -- of the architecture as it ran
    ending TEXT NOT NULL        -- done, failed
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


class Outcome(Struct, frozen=True, kw_only=True):
    """How an action ended that an architecture took part in; `at` [s since 1970]."""

    at: float
    action: str
    conditions: Conditions = Conditions()
    function: str
    architecture: str
    hash: str
    ending: Ending


class SuccessStore(SqliteFile):
    """Outcomes by robot; all remain until they are reset."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _SCHEMA, "outcomes of actions")

    def add(self, robot: str, outcome: Outcome) -> None:
        """Add an outcome."""
        self.execute(
            "INSERT INTO outcomes (robot, at, action, situation, function,"
            " architecture, hash, ending) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            robot,
            outcome.at,
            outcome.action,
            _text(outcome.conditions),
            outcome.function,
            outcome.architecture,
            outcome.hash,
            outcome.ending,
        )

    def posteriors(
        self, robot: str, architecture: str
    ) -> dict[tuple[str, Conditions, str], Posterior]:
        """Return (action, conditions, hash) -> what its outcomes say of success."""
        rows = self.execute(
            "SELECT action, situation, hash, SUM(ending = 'done'), "
            "SUM(ending = 'failed') FROM outcomes WHERE robot = ? AND architecture = ?"
            " GROUP BY action, situation, hash ORDER BY MIN(id)",
            robot,
            architecture,
        )
        return {
            (action, msgspec.json.decode(text, type=Conditions), hash_): Posterior(*n)
            for action, text, hash_, *n in rows
        }

    def reset(self, robot: str, architecture: str) -> int:
        """Forget the outcomes of an architecture; return how many there were."""
        return self.execute(
            "DELETE FROM outcomes WHERE robot = ? AND architecture = ?",
            robot,
            architecture,
        ).rowcount


def _text(conditions: Conditions) -> str:
    return msgspec.json.encode(conditions).decode()
