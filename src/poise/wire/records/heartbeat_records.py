"""Heartbeats, by which manager and agents know whether they reach each other."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.wire.records.request_records import PROTOCOL


class Echo(Struct, frozen=True, array_like=True, gc=False):
    """The last heartbeat that the sender has heard of another participant.

    Parameters
    ----------
    sent
        Its time, by the other's clock [s].
    held
        How long ago it came [s].
    is_cut_off
        Whether that one said that its lease has ended.
    """

    sent: float
    held: float
    is_cut_off: bool = False


class Heartbeat(Struct, frozen=True, array_like=True):
    """One datagram of a manager or an agent to all others of its robot.

    Parameters
    ----------
    sender
        A computer's name; ``MANAGER`` for the manager.
    key
        One start of the sender.
    number
        Counts this start's heartbeats.
    sent
        By the sender's clock [s].
    heard
        Whom it hears.
    managed
        How long ago it sent what its manager has heard [s]; None: not known. Of a
        manager: 0.
    manager
        The key of the manager that it obeys; empty: that one has ended, or there was
        none yet.
    is_cut_off
        Whether its lease has ended, so that its leased components are inactive.
    asks
        Who is asked to send a heartbeat at once: it was not heard for long.
    revoked
        Computer -> fencing token that has no effect any more: leased components were
        started elsewhere. Agents repeat what their manager says.
    """

    robot: str
    sender: str
    key: str
    number: int
    sent: float
    heard: Mapping[str, Echo] = {}
    managed: float | None = None
    manager: str = ""
    is_cut_off: bool = False
    asks: tuple[str, ...] = ()
    revoked: Mapping[str, int] = {}
    protocol: int = PROTOCOL


MANAGER = ""
"""The manager's name among the participants."""


class LinkQuality(Struct, frozen=True, kw_only=True):
    """A link between two computers, by the heartbeats of the last seconds.

    Parameters
    ----------
    delay
        One way, in the median [s]; None: nothing came back.
    loss
        The share of heartbeats that did not come; in [0, 1].
    silent
        For how long none came [s].
    """

    delay: float | None
    loss: float
    silent: float
