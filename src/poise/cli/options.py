"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path

from poise.errors import UsageError
from poise.units import Dimension, parse


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


def parse_option(option: str, text: str, dimension: Dimension) -> float:
    """Return the quantity that an option was given, in SI.

    Raises
    ------
    UsageError
        It is none; the message names the option and the accepted units.
    """
    try:
        return parse(text, dimension)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from error
