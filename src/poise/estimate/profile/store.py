"""All measurements of a robot, in an SQLite file beside the robot file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Self

import msgspec

from poise.errors import UsageError
from poise.estimate.profile import KindCosts, Profile

_SCHEMA = """
CREATE TABLE IF NOT EXISTS measurements (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    kind TEXT NOT NULL,  -- profile, or costs of connectors
    json TEXT NOT NULL
)
"""


class Store:
    """Profiles and calibrations by robot; all remain.

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
        """Add a profile."""
        self._add(profile.robot, "profile", profile)

    def all(self, robot: str) -> list[Profile]:
        """Return every profile of a robot, newest first."""
        profiles = self._newest_first(robot, "profile")
        return [msgspec.json.decode(text, type=Profile) for text in profiles]

    def latest(self, robot: str) -> Profile | None:
        """Return the newest profile of a robot."""
        return next(iter(self.all(robot)), None)

    def add_costs(self, robot: str, costs: Mapping[str, KindCosts]) -> None:
        """Add the costs of connectors on a robot's computers."""
        self._add(robot, "costs", costs)

    def latest_costs(self, robot: str) -> dict[str, KindCosts]:
        """Return the costs of connectors by the last calibration; empty without one."""
        text = next(self._newest_first(robot, "costs"), "{}")
        return msgspec.json.decode(text, type=dict[str, KindCosts])

    def _add(self, robot: str, kind: str, measured: object) -> None:
        self._database.execute(
            "INSERT INTO measurements (robot, kind, json) VALUES (?, ?, ?)",
            (robot, kind, msgspec.json.encode(measured).decode()),
        )

    def _newest_first(self, robot: str, kind: str) -> Iterator[str]:
        rows = self._database.execute(
            "SELECT json FROM measurements WHERE robot = ? AND kind = ?"
            " ORDER BY id DESC",
            (robot, kind),
        )
        return (text for (text,) in rows)
