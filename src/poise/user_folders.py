"""The folders of the user that a program runs as, and files for this user alone."""

from __future__ import annotations

import os
from pathlib import Path


def home_folder() -> Path:
    """Return it; ``/`` without HOME for a user who is in no list, as for a login."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")


def temporary_folder() -> Path:
    """Return TMPDIR, or /tmp, full or not: others look there for what runs."""
    named = os.environ.get("TMPDIR", "")
    is_usable = os.access(named, os.W_OK | os.X_OK)
    return Path(named if is_usable else "/tmp")  # noqa: S108 - callers check owner and mode


def write_private(path: Path, data: bytes, modified: float | None = None) -> None:
    """Write a file that nobody else can read, whole or not at all; OSError.

    `modified`: its time, if that is not to be now [s].
    """
    draft = path.with_suffix(".new")
    try:
        fd = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(fd, "wb") as file:
            file.write(data)
        if modified is not None:
            os.utime(draft, (modified, modified))
        draft.replace(path)
    except BaseException:  # nothing half done stays, whatever ends it
        draft.unlink(missing_ok=True)
        raise
