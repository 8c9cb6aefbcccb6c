"""The application as a library: `poise.load`, `place`, `run`, `up`, `profile` ...

Here is how a function that takes long says what it does, and how it is ended early.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

Say = Callable[[str], object]
"""Takes a sentence."""

log = logging.getLogger("poise")
"""Takes sentences by default."""

Check = Callable[[], object]
"""Called several times a second while a function waits; may raise to end that."""


_LOOK_EVERY = 0.1
"""A function that sleeps is checked after this time at most [s]."""


def sleep_until(moment: float, check: Check) -> None:
    """Sleep until a moment of `time.monotonic` [s], unless `check` ends that."""
    while (left := moment - time.monotonic()) > 0:
        check()
        time.sleep(min(left, _LOOK_EVERY))


def nothing(*_: object) -> None:
    """Let a function go on; or say nothing."""
