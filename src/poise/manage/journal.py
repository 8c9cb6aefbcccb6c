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
    """Written by the manager's thread; any program may read it meanwhile.

    Parameters
    ----------
    path
        The file; made when it is not there. ``:memory:`` keeps it in memory.

    Raises
    ------
    UsageError
        The file cannot be written, or is no journal.
    """

    def __init__(self, path: Path | str) -> None:
        self._path = path
        self._lost = 0
        try:
            self._database = sqlite3.connect(path, isolation_level=None, timeout=1.0)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=NORMAL")
            self._database.execute(_SCHEMA)
        except sqlite3.Error as error:
            raise UsageError(
                f"the journal {path} cannot be written: {error}. Name a file in a "
                "folder that is there, may be written, and has room"
            ) from error

    def note(self, kind: str, what: str, **facts: object) -> None:
        """Add a line: `what` for people, `facts` for machines.

        A robot must not stop because its diary is full: a line that cannot be written
        is lost, which is logged when it begins and when it is over.
        """
        text = msgspec.json.encode(facts).decode()
        try:
            self._database.execute(
                "INSERT INTO entries (at, kind, what, facts) VALUES (?, ?, ?, ?)",
                (time.time(), kind, what, text),
            )
        except sqlite3.Error as error:
            if not self._lost:
                log.warning("the journal %s takes no more: %s", self._path, error)
            self._lost += 1
        else:
            if self._lost:
                text = "the journal %s is written again; %d lines are lost"
                log.warning(text, self._path, self._lost)
            self._lost = 0

    def entries(self) -> list[Entry]:
        """Return all lines, oldest first."""
        rows = self._database.execute(
            "SELECT at, kind, what, facts FROM entries ORDER BY id"
        )
        return [Entry(at, k, what, msgspec.json.decode(f)) for at, k, what, f in rows]

    def close(self) -> None:
        """Close the file."""
        self._database.close()
