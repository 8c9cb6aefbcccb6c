"""What a command that waits for a migration says meanwhile, on standard error."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from poise import threads
from poise.errors import PoiseError
from poise.session.running_robots.running import Running

TELL_EVERY = 1.0
"""What is under way is told this often [s]."""


@contextmanager
def telling_progress(running: Running) -> Iterator[None]:
    """Say what migrations of a robot wait for, until the block ends."""
    is_over = threading.Event()

    def tell() -> None:
        while not is_over.wait(TELL_EVERY):
            try:
                sentences = running.status().under_way
            except PoiseError:  # the command itself says why
                return
            sys.stderr.writelines(f"{each}\n" for each in sentences)

    telling = threads.daemon(tell, "progress")
    telling.start()
    try:
        yield
    finally:
        is_over.set()
        telling.join(TELL_EVERY)
