"""The age of a checkpoint file, whatever becomes of the computer's wall clock.

The time of modification of such a file is the time since the computer started, which
nobody sets and which goes on while the computer sleeps.
"""

from __future__ import annotations

import os
import time
from pathlib import Path


def stamp(path: Path, age: float = 0.0) -> None:
    """Note that the content of a file is `age` [s] old; raises OSError."""
    at = _now() - int(age * 1e9)
    os.utime(path, ns=(at, at))


def age_of(modified: int) -> float:
    """Return the age [s] of a file by its ``st_mtime_ns``.

    Of one that was stamped before the computer started last, it is what is sure: the
    time since then.
    """
    age = _now() - modified
    return (age if age >= 0 else _now()) / 1e9


def _now() -> int:
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
