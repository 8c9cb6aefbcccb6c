"""An SQLite file beside the robot file, for what is kept from run to run."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Self

from poise.errors import UsageError


class SqliteFile:
    """Tables in a file; the file and its folder are created if missing."""

    def __init__(self, path: Path, schema: str, holds: str) -> None:
        self._path = path
        self._holds = holds
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, isolation_level=None, timeout=1.0)
        except (OSError, sqlite3.Error) as error:
            raise self._broken(error) from error
        self.execute(schema)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def execute(self, statement: str, *values: str | float) -> sqlite3.Cursor:
        """Carry a statement out; UsageError when that fails."""
        try:
            return self._database.execute(statement, values)
        except sqlite3.Error as error:
            raise self._broken(error) from error

    def _broken(self, error: Exception) -> UsageError:
        return UsageError(
            f"{self._path} cannot store {self._holds}: {error}. If it is damaged, "
            "remove it: its content is lost then"
        )
