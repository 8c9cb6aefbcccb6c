"""Options that several commands have."""

from __future__ import annotations

from poise.errors import UsageError
from poise.units import Dimension, parse


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
