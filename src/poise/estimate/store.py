"""All profiles that were ever measured, in an SQLite file beside the robot file."""

from __future__ import annotations

import hashlib
import sqlite3
from pathlib import Path
from typing import Self

import msgspec

from poise.estimate.profile import Profile

_SCHEMA = """
CREATE TABLE IF NOT EXISTS profiles (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    computer TEXT NOT NULL,
    poise TEXT NOT NULL,
    version TEXT NOT NULL,  -- of all implementations together
    at TEXT NOT NULL,
    profile TEXT NOT NULL   -- JSON
)
"""


class Store:
    """Profiles by robot, computer, version of Poise and version of the code.

    Parameters
    ----------
    path
        The file; it and its folder are made when they are not there.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._database = sqlite3.connect(path, isolation_level=None, timeout=1.0)
        self._database.execute(_SCHEMA)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def add(self, profile: Profile) -> None:
        """Keep a profile; older ones stay."""
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
        """Return the newest profile of a robot, on `computer` if that is given."""
        for profile in self.all(robot):
            if computer in (None, profile.computer):
                return profile
        return None


def version_of_all(profile: Profile) -> str:
    """Return one fingerprint of all implementations that were measured."""
    versions = sorted((n, c.version) for n, c in profile.components.items())
    return hashlib.sha256(msgspec.json.encode(versions)).hexdigest()[:16]
