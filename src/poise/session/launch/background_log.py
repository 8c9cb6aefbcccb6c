"""The log of a process in the background: a file, and the end of what was before.

What it starts, such as agents and their containers, appends to the same file.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from poise.errors import UsageError
from poise.session.folders import state_folder

LARGEST = 1_000_000
"""A log that is larger is emptied; as much of its end is kept [bytes]."""
_STDOUT = 1


def log_of(name: str) -> Path:
    """Return the path of a log, to append to."""
    path = state_folder() / f"{name}.log"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(0o600)  # what components print is this user's alone
    except OSError as error:
        raise UsageError(
            f"{path} cannot be written: {error.strerror}. It is the log of a process "
            "in the background: choose another folder by XDG_STATE_HOME"
        ) from error
    return path


def keep_log_small() -> None:
    """Empty this process's log, if it has one, when it is large."""
    with contextlib.suppress(OSError):  # of the disk, or it has no standard output
        size = os.fstat(_STDOUT).st_size
        if size > LARGEST:
            path = Path(f"/proc/self/fd/{_STDOUT}").readlink()
            if path.parent == state_folder().resolve() and path.suffix == ".log":
                _keep_end(path, size)
                os.ftruncate(_STDOUT, 0)


def _keep_end(path: Path, size: int) -> None:
    before = path.with_suffix(".before.log")
    with contextlib.suppress(OSError), path.open("rb") as file:  # the disk is full
        file.seek(size - LARGEST)
        before.touch(0o600)
        before.write_bytes(file.read(LARGEST))
