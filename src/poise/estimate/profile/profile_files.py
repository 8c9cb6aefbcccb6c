"""A profile as a YAML file beside the robot file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
import yaml

from poise.errors import RobotError
from poise.estimate.profile import KindCosts, Profile
from poise.estimate.sqlite_file import SqliteFile

_HEAD = """\
# Written by `poise profile`; do not edit it.
# CPU in cores of the reference computer, memory and sizes in bytes, times in seconds.
"""
_DIGITS = 4
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The quick one is not everywhere."""


def to_text(profile: Profile) -> str:
    """Return the profile as YAML; numbers keep `_DIGITS` digits."""
    plain = _rounded(msgspec.to_builtins(profile))
    return _HEAD + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)


def from_text(text: str, file: str) -> Profile:
    """Return the profile in a YAML text."""
    try:
        return msgspec.convert(yaml.load(text, _LOADER), Profile)  # noqa: S506 - both are safe
    except yaml.YAMLError as error:
        raise RobotError(f"{file}: not YAML: {error}") from error
    except msgspec.ValidationError as error:
        raise RobotError(
            f"{file}: not a profile: {error}. Write it again with `poise profile`"
        ) from error


def read(path: Path) -> Profile:
    """Return the profile in a file; raises as `from_text`, or if it is unreadable."""
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(
            f"profile {path} cannot be read: {error}. `poise profile` writes it"
        ) from error
    return from_text(text, str(path))


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


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
