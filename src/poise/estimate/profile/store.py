"""All measurements of a robot, in an SQLite file beside the robot file."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import msgspec

from poise.errors import UsageError
from poise.estimate.profile import KindCosts, Profile

_SCHEMA = """
CREATE TABLE IF NOT EXISTS profiles (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    computer TEXT NOT NULL,
    poise TEXT NOT NULL,
    version TEXT NOT NULL,  -- of all implementations together
    at TEXT NOT NULL,
    profile TEXT NOT NULL   -- JSON
);
CREATE TABLE IF NOT EXISTS calibrations (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    at TEXT NOT NULL,
    costs TEXT NOT NULL     -- JSON: kind of connector -> KindCosts
)
"""


class Store:
    """Profiles by robot, computer, version of Poise and of the code; and calibrations.

    Parameters
    ----------
    path
        The file; it and its folder are created if missing.

    Raises
    ------
    UsageError
        It cannot be created, or is no SQLite file.
    """

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, isolation_level=None, timeout=1.0)
            self._database.executescript(_SCHEMA)
        except (OSError, sqlite3.Error) as error:
            raise UsageError(f"{path} cannot store profiles: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def add(self, profile: Profile) -> None:
        """Add a profile; older ones remain."""
        self._database.execute(
            "INSERT INTO profiles (robot, computer, poise, version, at, profile)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            (
                profile.robot,
                profile.computer,
                profile.poise,
                version_of_all(profile),
                profile.at,
                msgspec.json.encode(profile).decode(),
            ),
        )

    def all(self, robot: str) -> list[Profile]:
        """Return every profile of a robot, newest first."""
        rows = self._database.execute(
            "SELECT profile FROM profiles WHERE robot = ? ORDER BY id DESC", (robot,)
        )
        return [msgspec.json.decode(text, type=Profile) for (text,) in rows]

    def latest(self, robot: str, computer: str | None = None) -> Profile | None:
        """Return the newest profile of a robot (on `computer`, if given)."""
        for profile in self.all(robot):
            if computer in (None, profile.computer):
                return profile
        return None

    def add_costs(self, robot: str, costs: Mapping[str, KindCosts]) -> None:
        """Add the costs of connectors on a robot's computers; older ones remain."""
        self._database.execute(
            "INSERT INTO calibrations (robot, at, costs)"
            " VALUES (?, datetime('now'), ?)",
            (robot, msgspec.json.encode(costs).decode()),
        )

    def latest_costs(self, robot: str) -> dict[str, KindCosts]:
        """Return the costs of connectors by the last calibration; empty without one."""
        row = self._database.execute(
            "SELECT costs FROM calibrations WHERE robot = ? ORDER BY id DESC LIMIT 1",
            (robot,),
        ).fetchone()
        return msgspec.json.decode(row[0], type=dict[str, KindCosts]) if row else {}


def version_of_all(profile: Profile) -> str:
    """Return one fingerprint of all measured implementations."""
    versions = sorted((n, c.version) for n, c in profile.components.items())
    return hashlib.sha256(msgspec.json.encode(versions)).hexdigest()[:16]
