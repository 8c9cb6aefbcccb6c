"""Every decision of the manager, and what came of it, in an SQLite file."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
from msgspec import Struct

from poise.errors import UsageError

log = logging.getLogger(__name__)

Kind = Literal["seen", "decided", "done", "failed", "wrong", "right"]
"""What an entry is about.

seen
    Something was noticed that needs no action.
decided
    The manager decided what to do next.
done, failed
    It did that, or could not.
wrong, right
    Something is not as the robot file says any more, or is so again.
"""

KINDS: tuple[str, ...] = get_args(Kind)

_SCHEMA = """
CREATE TABLE IF NOT EXISTS entries (
    id INTEGER PRIMARY KEY,
    at REAL NOT NULL,     -- seconds since the epoch
    kind TEXT NOT NULL,   -- seen, decided, done, failed, wrong, right
    what TEXT NOT NULL,   -- one sentence for people
    facts TEXT NOT NULL   -- JSON for machines
)
"""


class Entry(Struct, frozen=True):
    """An entry of the journal; `at` in seconds since 1970.

    `number` counts the entries of one file; 0: it is not read from one.
    """

    at: float
    kind: Kind
    what: str
    facts: Any
    number: int = 0

    def __str__(self) -> str:
        """Return time and sentence, for people."""
        return f"{time.strftime('%H:%M:%S', time.localtime(self.at))} {self.what}"


class Journal:
    """Written by one thread at a time; any program may read it meanwhile.

    An entry that cannot be written is logged instead, because the robot goes on: the
    disk may be full, or another program may hold the file.

    Parameters
    ----------
    path
        The file; created when it does not exist. ``:memory:`` keeps it in memory.
    show
        Called with each entry, in order; must not block.

    Raises
    ------
    UsageError
        It cannot be opened, or is something else.
    """

    def __init__(
        self, path: Path | str, show: Callable[[Entry], object] | None = None
    ) -> None:
        self._show = show
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

    def note(self, kind: Kind, what: str, **facts: object) -> None:
        """Add an entry: `what` for people, `facts` for machines."""
        now = time.time()
        if self._show is not None:
            self._show(Entry(now, kind, what, facts))
        text = msgspec.json.encode(facts).decode()
        try:
            self._database.execute(
                "INSERT INTO entries (at, kind, what, facts) VALUES (?, ?, ?, ?)",
                (now, kind, what, text),
            )
        except sqlite3.Error as error:
            log.warning("not in the journal (%s): %s: %s", error, kind, what)

    def entries(self) -> list[Entry]:
        """Return all entries, oldest first."""
        return _entries(self._database)

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def read_journal(path: Path | str, after: int = 0) -> list[Entry]:
    """Return the entries of a journal, oldest first, also while a manager writes it.

    Parameters
    ----------
    after
        Only entries with a higher number.

    Raises
    ------
    UsageError
        There is no such file, or it is no journal.
    """
    where = Path(path).resolve().as_uri()
    try:
        with contextlib.closing(
            sqlite3.connect(f"{where}?mode=ro", uri=True, timeout=1.0)
        ) as database:
            return _entries(database, after)
    except sqlite3.Error as error:
        raise UsageError(
            f"the journal {path} cannot be read: {error}. Name the file of "
            "`poise up --journal`, or journal.sqlite in `poise run --report`'s folder"
        ) from error


def _entries(database: sqlite3.Connection, after: int = 0) -> list[Entry]:
    rows = database.execute(
        "SELECT at, kind, what, facts, id FROM entries WHERE id > ? ORDER BY id",
        (after,),
    )
    return [
        Entry(at, kind, what, msgspec.json.decode(facts), number)
        for at, kind, what, facts, number in rows
    ]
