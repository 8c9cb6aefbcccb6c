"""Heartbeats, by which manager and agents know whether they reach each other."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct


class Echo(Struct, frozen=True, array_like=True, gc=False):
    """The last heartbeat that the sender has heard of another participant."""

    sent: float  # Its time, by the other's clock [s]
    held: float  # How long ago it came [s]
    is_cut_off: bool = False  # Whether that one said that its lease has ended


class Heartbeat(Struct, frozen=True, array_like=True):
    """One datagram of a manager or an agent to all others of its robot."""

    robot: str
    sender: str  # A computer's name; ``MANAGER`` for the manager
    key: str  # One start of the sender
    number: int  # Counts this start's heartbeats
    sent: float  # By the sender's clock [s]
    heard: Mapping[str, Echo] = {}  # Whom it hears
    # How long ago it sent what its manager has heard [s]; 0 for a manager; None: not
    # known
    managed: float | None = None
    # The key of the manager that it obeys; empty: that one has ended, or there was none
    # yet
    manager: str = ""
    # Whether its lease has ended, so that its leased components are inactive
    is_cut_off: bool = False
    # Who is asked to send a heartbeat at once: it was not heard for long
    asks: tuple[str, ...] = ()
    # Computer -> fencing token that has no effect any more: leased components were
    # started elsewhere. Agents repeat what their manager says.
    revoked: Mapping[str, int] = {}


MANAGER = ""
"""The manager's name among the participants."""


class LinkQuality(Struct, frozen=True, kw_only=True):
    """A link between two computers, by the heartbeats of the last seconds."""

    delay: float | None  # One way, in the median [s]; None: nothing came back
    loss: float  # The share of heartbeats that did not come; in [0, 1]
    silent: float  # For how long none came [s]


class ClockStatus(Struct, frozen=True, kw_only=True):
    """Another computer's clock, as seen from one."""

    offset: float  # The other's clock minus this one [s]
    # It is surely not further off than this [s]: half of what the quickest ways there
    # and back left open, and what the clocks may have run apart since
    error: float
    at: float  # When that was so [s, on this clock]
    trip: float  # The quickest of the last round trips [s]


class Clocks(Struct, frozen=True, tag=True):
    """What an agent tells its containers of other computers."""

    known: Mapping[str, ClockStatus]  # Computer -> its clock
    silent: frozenset[str] = frozenset()  # Those that are not heard
