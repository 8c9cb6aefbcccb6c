"""What a viewer asks of the container where a connector begins, and what it gets."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

SHOWN_ITEMS = 16
"""So many items of a list, an array or a mapping are shown to people."""


class Tap(Struct, frozen=True, tag=True, kw_only=True):
    """Tell what has gone out over a connector since the last time.

    A container taps the connector for some seconds; who goes on looking asks again.

    Parameters
    ----------
    number
        Tells this request from others.
    limit
        It is answered within this time [s].
    viewer
        Who looks: each gets all for itself.
    rate
        So many messages a second are told with their content; 0: none is.
    items
        Of longer lists, arrays and mappings the rest is left out; up to `SHOWN_ITEMS`,
        lists and mappings then end with how much that is.
    """

    number: int
    container: str
    connector: str
    viewer: str
    rate: float = 0.0
    items: int = SHOWN_ITEMS
    limit: float = 1.0


class Passed(Struct, frozen=True):
    """A message, or a call.

    Parameters
    ----------
    at
        When it went out, or the call's answer came [s since 1970].
    value
        Its content as plain values, shortened where it is long.
    is_whole
        Whether nothing was shortened.
    """

    at: float
    value: Any
    is_whole: bool = True


class TapReading(Struct, frozen=True, tag=True, kw_only=True):
    """What went out since the last reading.

    Parameters
    ----------
    carries
        The declared type of the messages, or the interface.
    times
        When each message or call went out [s since 1970]; some may be missing.
    passed
        Some of them with their content.
    missing
        How many are not among the times: there was no room for them.
    """

    number: int
    connector: str
    carries: str
    times: tuple[float, ...] = ()
    passed: tuple[Passed, ...] = ()
    missing: int = 0
