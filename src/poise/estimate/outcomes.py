"""How actions ended, and with which architectures: kept beside the robot file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from poise.clock import wall_time
from poise.decoding import from_json
from poise.errors import UsageError, unknown
from poise.estimate.code_version import hash_of
from poise.estimate.profiles import SqliteFile
from poise.model.robot import Architecture, Robot

STORE = Path(".poise") / "success.sqlite"
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


Alternative = tuple[str, str]
"""An architecture and its hash."""
Outcome = tuple[Alternative, bool]
"""What served an action, and whether it was done."""


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
    served = [named_architecture(robot, name) for name in architectures]
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


def outcomes_of(
    robot: Robot, function: str
) -> tuple[dict[tuple[str, Conditions], list[Outcome]], int]:
    """Return (action, conditions) -> outcomes in their order; and the last one's id."""
    outcomes: dict[tuple[str, Conditions], list[Outcome]] = {}
    last = 0
    if _has_outcomes(robot):
        with _store(robot) as store:
            rows = store.execute(
                "SELECT id, action, situation, architecture, hash, ending FROM outcomes"
                " WHERE robot = ? AND function = ? ORDER BY id",
                *(robot.name, function),
            )
            for last, action, situation, name, hash_, ending in rows:  # noqa: B007
                conditions = from_json(situation, Conditions)
                of = outcomes.setdefault((action, conditions), [])
                of.append(((name, hash_), ending == "done"))
    return outcomes, last


def forget(robot: Robot, architecture: str) -> int:
    """Forget what was learned of an architecture; return the number of outcomes."""
    named_architecture(robot, architecture)
    if not _has_outcomes(robot):
        return 0
    with _store(robot) as store:
        return store.execute(
            "DELETE FROM outcomes WHERE robot = ? AND architecture = ?",
            *(robot.name, architecture),
        ).rowcount


def named_architecture(robot: Robot, name: str) -> Architecture:
    """Return an architecture of the robot; UsageError: it has none of this name."""
    names = [a.name for a in robot.architectures]
    if name not in names:
        raise UsageError(unknown("architecture", name, names))
    return robot.architecture(name)


def _has_outcomes(robot: Robot) -> bool:
    return bool(robot.folder) and (Path(robot.folder) / STORE).exists()


def _store(robot: Robot) -> SqliteFile:
    if not robot.folder:
        raise UsageError(
            f"robot '{robot.name}' is from no file, so there is no folder to keep "
            "outcomes in: load it with `poise.load`, or set its `folder`"
        )
    return SqliteFile(Path(robot.folder) / STORE, _SCHEMA, "outcomes of actions")
