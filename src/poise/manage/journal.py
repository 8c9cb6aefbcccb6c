"""Every decision of the manager, and what came of it: a line of JSON each."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
from msgspec import Struct

from poise.clock import time_of_day, wall_time
from poise.decoding import json_decoder
from poise.errors import UsageError
from poise.manage.background_file import BackgroundFile, numbered
from poise.units import counted

log = logging.getLogger(__name__)

EntryKind = Literal["seen", "decided", "desired", "done", "failed", "wrong", "right"]
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

LARGEST, FILES = 4 << 20, 4
"""The most files of a journal, and the size of each [bytes]."""
MOST_KEPT = 2_000
"""So many entries are kept in memory."""
_MOST_KEPT_SIZE = 8 << 20
_MOST_WAITING = 1 << 20
_MOST_RECENT = 20
_TAIL = 64 << 10
KINDS: tuple[str, ...] = get_args(EntryKind)


class JournalEntry(Struct, frozen=True):
    """An entry of the journal; `at` in seconds since 1970.

    `number` counts the entries of a journal, also over several managers.
    """

    at: float
    kind: EntryKind
    what: str
    facts: Any
    number: int = 0

    def __str__(self) -> str:
        """Return time and sentence, for people."""
        try:
            at = time_of_day(self.at)
        except (OverflowError, OSError, ValueError):
            at = f"{self.at:g} s"  # it is no moment
        return f"{at} {self.what}"


_decode = json_decoder(JournalEntry).decode


class Journal:
    """Takes entries on any thread, and never raises; any program may read its file.

    A thread of its own writes them. When they cannot be written, because the disk is
    full, say, `file.trouble` says so, and the last are kept in memory.

    `path`: the file; created when it does not exist. ``:memory:`` keeps it in memory.
    `show`: called with each entry, in order; must not block.
    `file`: None: it is only in memory.
    `forgotten`: how many entries memory holds no more.
    """

    def __init__(
        self, path: Path | str, show: Callable[[JournalEntry], object] | None = None
    ) -> None:
        self._show = show
        self._lock = threading.RLock()
        self._kept: deque[bytes] = deque()
        self._kept_size = 0
        self.forgotten = 0
        self._refused = ""
        self.file: BackgroundFile | None = None
        self._number = 0
        if path != ":memory:":
            self._number = _last_number(Path(path))
            self.file = BackgroundFile(
                Path(path),
                "the journal",
                "line",
                most=_MOST_WAITING,
                largest=LARGEST,
                files=FILES,
            )
            # after a manager that was killed; also what tells whether it can be written
            self.file.add(b"\n" if _ends_amid_a_line(Path(path)) else b"")
            self.file.start()

    @property
    def trouble(self) -> str:
        """Why entries are not written as they are; empty: they are."""
        return (self.file.trouble if self.file else "") or self._refused

    def recent(self) -> tuple[JournalEntry, ...]:
        """Return the last entries without their facts; any thread may ask."""
        last = self.entries(most=_MOST_RECENT)
        return tuple(msgspec.structs.replace(e, facts=None, number=0) for e in last)

    def note(self, kind: EntryKind, what: str, **facts: object) -> None:
        """Add an entry: `what` for people, `facts` for machines."""
        refused = ""
        with self._lock:
            self._number += 1
            entry = JournalEntry(wall_time(), kind, what, facts, self._number)
            try:
                line = msgspec.json.encode(entry)
            except Exception as error:  # noqa: BLE001, the robot goes on
                refused = f"the facts of a journal entry are lost: {error!r}"
                what = what.encode(errors="replace").decode()
                entry = msgspec.structs.replace(entry, what=what, facts={})
                line = msgspec.json.encode(entry)
            self._keep(line)
            if self.file is not None:
                self.file.add(line + b"\n")
            self._say(entry)
        if refused and not self._refused:
            self._refused = refused
            self.note("wrong", f"{refused}; the entry is: {what}")

    def entries(self, after: int = 0, most: int = MOST_KEPT) -> list[JournalEntry]:
        """Return this manager's last entries, oldest first, from memory.

        At most `MOST_KEPT`, and the last `most` of those with numbers above `after`.
        """
        kept = list(self._kept.copy())  # without the lock: `show` may be slow
        last = kept[max(0, len(kept) - most) :]
        return [entry for entry in map(_decode, last) if entry.number > after]

    def close(self) -> None:
        """Write what is still to be written, and close the file."""
        if self.file is not None:
            self.file.close()

    def _keep(self, line: bytes) -> None:
        self._kept.append(line)
        self._kept_size += len(line)
        while len(self._kept) > MOST_KEPT or self._kept_size > _MOST_KEPT_SIZE:
            self._kept_size -= len(self._kept.popleft())
            self.forgotten += 1

    def _say(self, entry: JournalEntry) -> None:
        if self._show is not None and entry.kind != "desired":
            try:
                self._show(entry)
            except Exception:  # its reader's fault does not stop the robot
                log.exception("an entry of the journal could not be shown: %s", entry)


def check_journal(path: Path | None) -> None:
    """Raise UsageError when a file that a user names can be no journal."""
    if path is None:
        return
    try:
        if not path.parent.is_dir():
            raise UsageError(
                f"the journal {path} cannot be written: there is no folder "
                f"{path.parent}. Name a file in a folder that is there"
            )
        text = path.read_bytes()[:_TAIL] if path.exists() else b""
    except OSError as error:
        raise UsageError(
            f"the journal {path} cannot be written: {error.strerror}. Name another file"
        ) from error
    lines = text.splitlines()
    if any(lines) and not any(_parsed(line) for line in lines):
        raise UsageError(
            f"the journal {path} cannot be written: the file is something else. Name "
            "another one"
        )


def read_journal(path: Path | str, after: int = 0) -> list[JournalEntry]:
    """Return the entries of a journal, oldest first, also while a manager writes it.

    Lines that are no entries are left out, and counted in a warning: a manager that is
    killed may leave half a line.

    Parameters
    ----------
    path
        Its newest file; those before it, ``path.1`` and so on, are read, too.
    after
        Only entries with a higher number.

    Raises
    ------
    UsageError
        There is no such file, or it is no journal.
    """
    path = Path(path)
    found: list[JournalEntry] = []
    num_others = 0
    try:
        for line in _lines_backwards(path):
            entry = _parsed(line)
            if entry is None:
                num_others += 1
            elif after and entry.number <= after:
                break
            else:
                found.append(entry)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error
    if num_others and not found and not after:
        raise _unreadable(path, "it is not a journal")
    if num_others:
        lines = counted(num_others, "line")
        log.warning("the journal %s: skipped %s without a journal entry", path, lines)
    return found[::-1]


def _unreadable(path: Path, why: str) -> UsageError:
    return UsageError(
        f"the journal {path} cannot be read: {why}. Name the file of `poise up "
        "--journal`, or journal.jsonl in `poise run --report`'s folder; without a "
        "file, `poise journal` shows the last robot's"
    )


def _lines_backwards(path: Path) -> Iterator[bytes]:
    """Yield the lines of a journal, the last one first."""
    yield from filter(None, reversed(path.read_bytes().split(b"\n")))
    for older in numbered(path, FILES):
        if older.exists():
            yield from filter(None, reversed(older.read_bytes().split(b"\n")))


def _parsed(line: bytes) -> JournalEntry | None:
    try:
        return _decode(line)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def _ends_amid_a_line(path: Path) -> bool:
    with contextlib.suppress(OSError):  # it cannot be read
        return path.read_bytes()[-1:] not in {b"", b"\n"}
    return False


def _last_number(path: Path) -> int:
    """Return the number of a journal's last entry; 0: it has none that can be read."""
    for candidate in (path, *numbered(path, FILES)[:1]):
        with contextlib.suppress(OSError):
            lines = reversed(candidate.read_bytes().split(b"\n"))
            if (entry := next(filter(None, map(_parsed, lines)), None)) is not None:
                return entry.number
    return 0
