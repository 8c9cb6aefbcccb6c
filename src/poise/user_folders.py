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


def write_private(path: Path, data: bytes) -> None:
    """Write a file that, if it is new, nobody else can read."""
    with open(path, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as to:
        to.write(data)
