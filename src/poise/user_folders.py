"""The folders of the user that a program runs as."""

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
