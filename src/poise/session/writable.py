"""Whether a file can be written, found out before work begins."""

from __future__ import annotations

from pathlib import Path

from poise.errors import UsageError


def to_write(path: Path | None) -> Path | None:
    """Return the path of a file that is written at the end, when it can be.

    Raises
    ------
    UsageError
        It cannot; nothing was begun.
    """
    if path is None:
        return None
    is_new = not path.exists()
    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    if is_new:
        path.unlink()
    return path
