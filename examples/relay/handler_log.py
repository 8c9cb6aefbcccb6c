"""Logs when the handlers of components run, by the clock of the machine.

Emulated computers share that clock, so the logs show two incarnations of a component
that work at the same time.
"""

from __future__ import annotations

import os
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FOLDER = Path(__file__).parent / "handler-log"
"""Nothing is logged unless this folder exists."""


class HandlerLog:
    """The log of one incarnation of a component: a file that only grows.

    Each line is written at once, so that a killed process leaves what it did.
    """

    def __init__(self, component: str) -> None:
        # each emulated computer has a folder of its own for temporary files
        computer = Path(tempfile.gettempdir()).name
        name = f"{component}.{computer}.{os.getpid()}.{secrets.token_hex(4)}"
        self._file = FOLDER / name

    @contextmanager
    def run(self) -> Iterator[None]:
        """Log the begin and the end of a handler."""
        self._stamp("begin")
        try:
            yield
        finally:
            self._stamp("end")

    def go_on(self) -> None:
        """Log that a long handler is still at work."""
        self._stamp("on")

    def _stamp(self, what: str) -> None:
        now = time.clock_gettime(time.CLOCK_MONOTONIC)
        if FOLDER.is_dir():
            with self._file.open("a") as file:
                file.write(f"{what} {now:.6f}\n")
