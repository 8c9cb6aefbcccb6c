"""The folder of the user that a program runs as."""

from __future__ import annotations

from pathlib import Path


def home_folder() -> Path:
    """Return it; ``/`` without HOME for a user who is in no list, as for a login."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")
