"""Files that grow by records, on threads of their own: a slow disk delays nobody."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, TypeVar

from poise import threads
from poise.errors import RunError
from poise.units import counted

_RETRY_AFTER = 1.0
"""What could not be written is tried again after this time [s]."""
_SLOW_AFTER = 2.0
"""A disk that has not answered for this time [s] is said to be the trouble."""
_MOST_AT_ONCE = 1 << 20
"""At least one record, and up to so much, is written at once [bytes]."""
T = TypeVar("T")


class BackgroundWriter(Generic[T]):
    """Writes records to a file. Its methods never raise, and any thread may use them.

    `unit`: what a record is called; `most`: so much waits for the disk at most; further
    records are dropped [bytes]; `every`: what comes within this time is written at once
    [s].
    """

    close_limit = 2.0
    """What waits is written within this time at the end [s]."""

    def __init__(
        self, path: Path, name: str, unit: str, *, most: int, every: float = 0.0
    ) -> None:
        self.path = path
        self.missing = 0
        """How many records were dropped."""
        self._what, self._unit = f"{name} {path}", unit
        self._most, self._every = most, every
        self._waiting: deque[tuple[T, int]] = deque()
        self._size = 0
        self._changed = threading.Condition()
        self._is_closing = False
        self._error = ""
        self._began: float | None = None
        self._thread = threads.daemon(self._main, name, again=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, record: T, size: int) -> None:
        """Write a record soon; it is dropped and counted when too many wait."""
        with self._changed:
            if self._is_closing or self._size + size > self._most:
                self.missing += 1
                return
            self._waiting.append((record, size))
            self._size += size
            self._changed.notify_all()

    def write(self, records: Sequence[T]) -> None:
        """Write records, on its thread, and note how many.

        OSError or RunError: not all; what is not noted is written again later.
        """
        raise NotImplementedError

    def end(self) -> None:
        """End the file."""

    @property
    def trouble(self) -> str:
        """Why records are not written, and how many are missing; empty: all is well."""
        began, error = self._began, self._error
        if not error and began and time.monotonic() - began > _SLOW_AFTER:
            error = f"its disk has not answered for {_SLOW_AFTER:g} s"
        if error:
            return (
                f"{self._what} cannot be written: {error}{self._lacks(', and so far')}"
            )
        return self._what + lacks if (lacks := self._lacks("")) else ""

    def close(self) -> None:
        """Write what waits, within a limit; what then still waits is missing."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(self.close_limit)
        with self._changed:
            self.missing += len(self._waiting)
            self._waiting.clear()
            self._size = 0

    def _lacks(self, how: str) -> str:
        missing = self.missing
        return f"{how} lacks {counted(missing, self._unit)}" if missing else ""

    def _main(self) -> None:
        while records := self._next():
            self._began = time.monotonic()
            try:
                self.write(records)
            except (OSError, RunError) as error:
                cause = error.__cause__ or error  # which does not name the file
                self._note(str(getattr(cause, "strerror", "") or error))
                with self._changed:
                    if self._is_closing:
                        break
                    self._changed.wait_for(lambda: self._is_closing, _RETRY_AFTER)
            finally:
                self._began = None
        try:
            self.end()
        except RunError as error:
            self._note(str(error))

    def _next(self) -> list[T]:
        """Return what is to be written next, in trouble one record; nothing: close."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closing)
            self._changed.wait_for(lambda: self._is_closing, self._every)
            records: list[T] = []
            total = 0
            for record, size in self._waiting:
                if records and (self._error or total + size > _MOST_AT_ONCE):
                    break
                records.append(record)
                total += size
            return records

    def _note(self, error: str) -> None:
        with self._changed:
            self._error, self._began = error, None

    def note_written(self, count: int) -> None:
        """Note that the first so many of what waits are written."""
        with self._changed:
            for _ in range(min(count, len(self._waiting))):
                self._size -= self._waiting.popleft()[1]
            if not self._waiting:
                self._error = ""


class BackgroundFile(BackgroundWriter[bytes]):
    """Appends records to a file.

    A record is in the file whole or not at all, unless the process is killed while the
    kernel takes it. So a reader finds all but the last few milliseconds.

    `largest`: a file that would grow beyond it [bytes] is renamed to ``path.1``, that
    one to ``path.2``, and so on; the oldest of `files` is removed. 0: it may grow.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        unit: str,
        *,
        most: int,
        largest: int = 0,
        files: int = 1,
    ) -> None:
        super().__init__(path, name, unit, most=most)
        self._largest, self._files = largest, files
        self._fd = -1

    def add(self, record: bytes) -> None:
        """Write a record soon; it is dropped and counted when too many wait."""
        self.put(record, len(record))

    def write(self, records: Sequence[bytes]) -> None:
        """Append all records, or raise OSError and leave the file as it was."""
        data = b"".join(records)
        fd = self._opened()
        size = os.fstat(fd).st_size
        if self._largest and size and size + len(data) > self._largest:
            self._rotate()
            fd = self._opened()
            size = 0
        done = os.write(fd, data)
        if done < len(data):  # the next one would say that the disk is full
            if os.fstat(fd).st_size == size + done:
                os.ftruncate(fd, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.note_written(len(records))

    def end(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)

    def _opened(self) -> int:
        """Return the file, unless another one has its name by now."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                there, mine = self.path.stat(), os.fstat(self._fd)
                if (there.st_dev, there.st_ino) == (mine.st_dev, mine.st_ino):
                    return self._fd
            os.close(self._fd)
            self._fd = -1
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC
        try:
            self._fd = os.open(self.path, flags, 0o600)
        except FileNotFoundError:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(self.path, flags, 0o600)
        return self._fd

    def _rotate(self) -> None:
        paths = [self.path, *numbered(self.path, self._files)]
        for older, newer in zip(reversed(paths), reversed(paths[:-1]), strict=False):
            with contextlib.suppress(FileNotFoundError):
                newer.replace(older)


def numbered(path: Path, files: int) -> list[Path]:
    """Return the names that a file gets later: of `files` files, without its own."""
    return [path.with_name(f"{path.name}.{number}") for number in range(1, files)]
