"""What is known of other computers' clocks."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct


class ClockStatus(Struct, frozen=True, kw_only=True):
    """Another computer's clock, as seen from one."""

    offset: float  # The other's clock minus this one [s]
    # It is surely not further off than this [s]: half of what the quickest ways there
    # and back left open, and what the clocks may have run apart since
    error: float
    at: float  # When that was so [s, on this clock]
    trip: float  # The quickest of the last round trips [s]


class Clocks(Struct, frozen=True, tag=True):
    """What an agent tells its containers: computer -> its clock."""

    known: Mapping[str, ClockStatus]
