"""Every decision of the manager, and what came of it, in an SQLite file."""

from __future__ import annotations

import logging
import sqlite3
import time
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from poise.errors import UsageError

log = logging.getLogger(__name__)

_SCHEMA = """
CREATE TABLE IF NOT EXISTS entries (
    id INTEGER PRIMARY KEY,
    at REAL NOT NULL,     -- seconds since the epoch
    kind TEXT NOT NULL,   -- seen, decided, done, failed
    what TEXT NOT NULL,   -- one sentence for people
    facts TEXT NOT NULL   -- JSON for machines
)
"""


class Entry(Struct, frozen=True):
    """A line of the journal; `at` in seconds since the epoch."""

    at: float
    kind: str
    what: str
    facts: Any


class Journal:
    """Written by one thread at a time; any program may read it meanwhile.

    A line that cannot be written is logged instead, for the robot goes on: its disk
    may be full, or somebody may hold the file.

    Parameters
    ----------
    path
        The file; made when it is not there. ``:memory:`` keeps it in memory.

    Raises
    ------
    UsageError
        It cannot be opened, or is something else.
    """

    def __init__(self, path: Path | str) -> None:
        try:
            self._database = sqlite3.connect(
                path, isolation_level=None, timeout=1.0, check_same_thread=False
            )
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=NORMAL")
            self._database.execute(_SCHEMA)
        except sqlite3.Error as error:
            raise UsageError(
                f"the journal {path} cannot be written: {error}. Name a file in a "
                "folder that is there, may be written, and has room"
            ) from error

    def note(self, kind: str, what: str, **facts: object) -> None:
        """Add a line: `what` for people, `facts` for machines."""
        text = msgspec.json.encode(facts).decode()
        try:
            self._database.execute(
                "INSERT INTO entries (at, kind, what, facts) VALUES (?, ?, ?, ?)",
                (time.time(), kind, what, text),
            )
        except sqlite3.Error as error:
            log.warning("not in the journal (%s): %s: %s", error, kind, what)

    def entries(self) -> list[Entry]:
        """Return all lines, oldest first."""
        rows = self._database.execute(
            "SELECT at, kind, what, facts FROM entries ORDER BY id"
        )
        return [Entry(at, k, what, msgspec.json.decode(f)) for at, k, what, f in rows]

    def close(self) -> None:
        """Close the file."""
        self._database.close()
