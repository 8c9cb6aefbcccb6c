"""What is known of other computers' clocks."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct


class ClockStatus(Struct, frozen=True, kw_only=True):
    """Another computer's clock, as seen from one.

    Parameters
    ----------
    offset
        The other's clock minus this one [s].
    error
        It is surely not further off than this [s]: half of what the quickest ways there
        and back left open, and what the clocks may have run apart since.
    at
        When that was so [s, on this clock].
    trip
        The quickest of the last round trips [s].
    """

    offset: float
    error: float
    at: float
    trip: float


class Clocks(Struct, frozen=True, tag=True):
    """What an agent tells its containers: computer -> its clock."""

    known: Mapping[str, ClockStatus]
