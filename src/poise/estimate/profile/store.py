"""All measurements of a robot, in an SQLite file beside the robot file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from poise.estimate.profile import KindCosts, Profile
from poise.estimate.sqlite_file import SqliteFile

_SCHEMA = """
CREATE TABLE IF NOT EXISTS measurements (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    kind TEXT NOT NULL,  -- profile, or costs of connectors
    json TEXT NOT NULL
)
"""


class Store(SqliteFile):
    """Profiles and calibrations by robot; all remain."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _SCHEMA, "profiles")

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
        self.execute(
            "INSERT INTO measurements (robot, kind, json) VALUES (?, ?, ?)",
            robot,
            kind,
            msgspec.json.encode(measured).decode(),
        )

    def _newest_first(self, robot: str, kind: str) -> Iterator[str]:
        rows = self.execute(
            "SELECT json FROM measurements WHERE robot = ? AND kind = ?"
            " ORDER BY id DESC",
            robot,
            kind,
        )
        return (text for (text,) in rows)
