"""Waiting for what nobody tells of when it happens, with a limit."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

LIMIT = 20.0
"""Far longer than anything takes that a test of one part waits for [s]."""
LONG = 200.0
"""Far longer than any command takes [s]; below pytest's own limit."""


def wait_until(
    holds: Callable[[], object], limit: float = LIMIT, every: float = 0.001
) -> None:
    """Look again and again [every so many s]; fail after a limit [s]."""
    deadline = time.monotonic() + limit
    pause = threading.Event()
    while not holds():
        assert time.monotonic() < deadline, f"it did not hold within {limit:g} s"
        pause.wait(every)


wait_long = partial(wait_until, limit=LONG, every=0.02)
"""Wait for what commands do."""
