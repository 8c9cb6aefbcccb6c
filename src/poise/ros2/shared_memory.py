"""Removes the shared memory of Fast DDS processes that were killed.

Each leaves a segment of half a MB, which is in use as long as a process locks its
file of the same name with `_el`. Those of ports stay: the next process at a port uses
them.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from pathlib import Path

from poise.clock import wall_time

_LOCK = re.compile(r"fastdds_[0-9a-f]{16}_el")
_YOUNG = 60.0
"""A younger file may belong to a process that has yet to lock it [s]."""


def remove_leftovers(
    folder: Path = Path("/dev/shm"),  # noqa: S108, where Fast DDS has them
    young: float = _YOUNG,
) -> list[str]:
    """Remove the segments that no process uses; return their names."""
    removed = []
    for lock in folder.glob("fastdds_*_el"):
        with contextlib.suppress(OSError):  # in use, another user's, or just removed
            is_ours = lock.stat().st_uid == os.geteuid()
            is_old = wall_time() - lock.stat().st_mtime >= young
            if is_ours and is_old and _LOCK.fullmatch(lock.name):
                _remove(lock)
                removed.append(lock.name.removesuffix("_el"))
    return removed


def _remove(lock: Path) -> None:
    """Remove a segment and its lock; OSError when a process holds that."""
    with lock.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        lock.with_name(lock.name.removesuffix("_el")).unlink(missing_ok=True)
        lock.unlink()
