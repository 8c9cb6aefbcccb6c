"""Prints on a thread of its own, so that a full pipe blocks no other thread."""

from __future__ import annotations

import logging
import os
import queue
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

from poise import threads

STDOUT, STDERR = 1, 2
LONGEST_LINE = 1 << 16
"""A longer line of another process counts as several [bytes]."""
MOST_LINES = 10_000
"""At most this many lines wait to be printed; further ones are counted, and dropped."""
_CLOSE_LIMIT = 1.0
"""At the end, lines that wait are printed within this time [s], or never."""


_CONTROLS = re.compile(r"\x1b\[[\d;:]*m|[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Colours, and what else controls a terminal; not new lines and tabs."""


def visible(text: str, *, colours: bool = False) -> str:
    """Return text of others so that it controls no terminal; `colours`: they may pass.

    A component's error could clear the screen of a user who asks for the status.
    """

    def written(found: re.Match[str]) -> str:
        is_colour = colours and found.group().endswith("m")
        return found.group() if is_colour else ascii(found.group())[1:-1]

    return _CONTROLS.sub(written, text)


class Printer:
    """Prints to a descriptor of its own, so that a blocked print holds up no exit."""

    def __init__(self, fd: int = STDOUT) -> None:
        self._fd = fd
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_LINES)
        self._dropped = 0
        self._thread = threads.daemon(self._run, "printer")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._lines.put(None, timeout=_CLOSE_LIMIT)
        except queue.Full:
            return
        self._thread.join(_CLOSE_LIMIT)

    def print(self, line: str) -> None:
        """Print a line later, or count it when too many wait; from any thread."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self._dropped += 1

    def _run(self) -> None:
        try:
            while (line := self._lines.get()) is not None:
                self._write(line)
                if self._dropped and self._lines.empty():
                    dropped, self._dropped = self._dropped, 0
                    self._write(f"... {dropped} lines not shown")
        except OSError:  # nobody reads any more; the robot goes on
            return

    def _write(self, line: str) -> None:
        left = f"{visible(line, colours=True)}\n".encode(errors="replace")
        while left:
            left = left[os.write(self._fd, left) :]


@contextmanager
def relay(printer: Printer) -> Iterator[int]:
    """Give a descriptor of which all is printed as it comes: no process waits."""
    reading, writing = os.pipe()

    def run() -> None:
        with os.fdopen(reading, "rb") as lines:
            while line := lines.readline(LONGEST_LINE):
                printer.print(line.decode(errors="replace").removesuffix("\n"))

    thread = threads.daemon(run, "relay")
    thread.start()
    try:
        yield writing
    finally:
        os.close(writing)
        thread.join(_CLOSE_LIMIT)


@contextmanager
def log_printer() -> Iterator[None]:
    """Print the warnings of Poise to stderr on a thread of its own meanwhile."""
    logger = logging.getLogger("poise")
    with Printer(STDERR) as printer:
        handler = _LogPrinter(printer)
        logger.addHandler(handler)
        try:
            yield
        finally:
            logger.removeHandler(handler)


class _LogPrinter(logging.Handler):
    """Prints what is logged."""

    def __init__(self, printer: Printer) -> None:
        super().__init__(logging.WARNING)
        self._printer = printer

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record later."""
        self._printer.print(self.format(record))
