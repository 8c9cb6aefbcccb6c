"""All outcomes of a robot's actions, in an SQLite file beside the robot file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from poise.estimate.sqlite_file import SqliteFile
from poise.estimate.success.posterior import Posterior

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
