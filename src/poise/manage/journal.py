"""Every decision of the manager, and what came of it, in an SQLite file."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
from msgspec import Struct

from poise.clock import wall_time
from poise.errors import RunError, UsageError

log = logging.getLogger(__name__)

Kind = Literal["seen", "decided", "desired", "done", "failed", "wrong", "right"]
"""What an entry is about.

seen
    Something was noticed that needs no action.
decided
    The manager decided what to do next.
desired
    What should run is different from now on; not printed.
done, failed
    It did that, or could not.
wrong, right
    Something is not as the robot file says any more, or is so again.
"""

_MOST_RECENT = 20
KINDS: tuple[str, ...] = get_args(Kind)
_ALL = -1

_SCHEMA = """
CREATE TABLE IF NOT EXISTS entries (
    id INTEGER PRIMARY KEY,
    at REAL NOT NULL,     -- seconds since the epoch
    kind TEXT NOT NULL,   -- seen, decided, done, failed, wrong, right
    what TEXT NOT NULL,   -- one sentence for people
    facts TEXT NOT NULL   -- JSON for machines
)
"""


class JournalEntry(Struct, frozen=True):
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

    The robot goes on when an entry cannot be written: the disk may be full, or another
    program may hold the file. `trouble` says so until one can be again. A damaged file
    is put aside, and a new one begun.

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
        self, path: Path | str, show: Callable[[JournalEntry], object] | None = None
    ) -> None:
        self._path = None if path == ":memory:" else Path(path)
        self._show = show
        self._database: sqlite3.Connection | None = None
        self._inode = 0
        self._num_missing = 0
        self._recent: deque[JournalEntry] = deque(maxlen=_MOST_RECENT)
        self.trouble: str = ""
        """Why entries are not written; empty: they are."""
        try:
            self._open()
        except sqlite3.Error as error:
            if _is_damaged(self._path, error):
                self._begin_another(error)
            elif _code_of(error) in _NO_ROOM:
                self._note_missing(error)
            else:
                raise UsageError(
                    f"the journal {path} cannot be written: {error}. Name a file in a "
                    "folder that is there, may be written, and has room"
                ) from error

    def recent(self) -> tuple[JournalEntry, ...]:
        """Return the last entries without their facts; any thread may ask."""
        return tuple(self._recent.copy())

    def note(self, kind: Kind, what: str, **facts: object) -> None:
        """Add an entry: `what` for people, `facts` for machines."""
        entry = JournalEntry(wall_time(), kind, what, facts)
        self._recent.append(JournalEntry(entry.at, kind, what, None))
        if self._show is not None and kind != "desired":
            self._show(entry)
        try:
            self._write(entry)
        except sqlite3.Error as error:
            if _is_damaged(self._path, error):
                self._begin_another(error)
                self._write(entry)
            else:
                self._note_missing(error)
            return
        if self.trouble:
            text = (
                f"the journal is written again; {self._num_missing} entries are missing"
            )
            self.trouble, self._num_missing = "", 0
            self.note("right", text)

    def entries(self, after: int = 0, most: int = _ALL) -> list[JournalEntry]:
        """Return entries, oldest first: the last `most` with numbers above `after`.

        From any thread.

        Raises
        ------
        RunError
            They cannot be read.
        """
        try:
            return _entries(self._database, after, most) if self._database else []
        except sqlite3.Error as error:
            raise RunError(f"the journal cannot be read: {error}") from error

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open(self) -> sqlite3.Connection:
        database = sqlite3.connect(
            self._path or ":memory:",
            isolation_level=None,
            timeout=1.0,
            check_same_thread=False,
        )
        try:
            database.execute("PRAGMA journal_mode=WAL")
            database.execute("PRAGMA synchronous=NORMAL")
            database.execute(_SCHEMA)
        except sqlite3.Error:
            database.close()
            raise
        self._database, self._inode = database, _inode(self._path)
        return database

    def _write(self, entry: JournalEntry) -> None:
        if self._database is not None and _inode(self._path) != self._inode:
            self.close()  # SQLite would go on to write a file that nobody finds
            self._open()
            self.note(
                "wrong", f"the journal {self._path} was removed: a new one begins"
            )
        (self._database or self._open()).execute(
            "INSERT INTO entries (at, kind, what, facts) VALUES (?, ?, ?, ?)",
            (
                entry.at,
                entry.kind,
                entry.what,
                msgspec.json.encode(entry.facts).decode(),
            ),
        )

    def _note_missing(self, error: sqlite3.Error) -> None:
        self._num_missing += 1
        if not self.trouble:
            self.trouble = (
                f"the journal {self._path} cannot be written: {error}. Entries are "
                "only printed"
            )
            log.warning("%s", self.trouble)

    def _begin_another(self, error: sqlite3.Error) -> None:
        """Put the damaged file aside, and begin a new one."""
        assert self._path is not None  # noqa: S101, memory is not damaged
        self.close()
        aside = _put_aside(self._path)
        self._open()
        self.note(
            "wrong",
            f"the journal was damaged ({error}): it is {aside} now, and a new one "
            f"begins",
        )


_NO_ROOM = {
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_BUSY,
}
_DAMAGED = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}
_HEADER = b"SQLite format 3\0"


def _code_of(error: sqlite3.Error) -> int:
    """Return the primary code of an error; 0 when SQLite did not raise it."""
    code: int = getattr(error, "sqlite_errorcode", 0)
    return code & 0xFF


def _is_damaged(path: Path | None, error: sqlite3.Error) -> bool:
    """Return whether a file was a journal, and is none any more."""
    if path is None or _code_of(error) not in _DAMAGED:
        return False
    with contextlib.suppress(OSError), path.open("rb") as file:
        header = file.read(len(_HEADER))
        # anything else may be a file of the user's
        return header in {_HEADER, bytes(len(_HEADER))} or path.suffix == ".sqlite"
    return False


def _put_aside(path: Path) -> Path:
    """Rename a journal with its side files; return its new name."""
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(f"{aside}{suffix}")
    return aside


def _inode(path: Path | None) -> int:
    """Return what tells a file from others of its name; 0: there is none."""
    try:
        return path.stat().st_ino if path else 0
    except OSError:
        return 0


def read_journal(path: Path | str, after: int = 0) -> list[JournalEntry]:
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


def _entries(
    database: sqlite3.Connection, after: int = 0, most: int = _ALL
) -> list[JournalEntry]:
    rows = database.execute(
        "SELECT at, kind, what, facts, id FROM (SELECT * FROM entries WHERE id > ? "
        "ORDER BY id DESC LIMIT ?) ORDER BY id",
        (after, most),
    )
    return [
        JournalEntry(at, kind, what, msgspec.json.decode(facts), number)
        for at, kind, what, facts, number in rows
    ]
