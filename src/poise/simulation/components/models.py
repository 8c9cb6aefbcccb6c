"""What a simulated component does: how often, for how long, with how much state."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.simulation.schedule.choices import Choices


class ComponentModel(Struct, frozen=True, kw_only=True):
    """A component, as far as placement, leases and moves are concerned.

    Parameters
    ----------
    period
        Of its timer [s]; 0: it only handles messages.
    duration
        Least and most work of a handler [core-seconds]; drawn for each.
    start
        Shortest and longest time until it is configured [s].
    activate
        Longest time that `activate` or `deactivate` takes [s].
    state_size
        Of its snapshot [bytes].
    keep
        How many messages its mailbox keeps for each connector.
    """

    period: float = 0.1
    duration: tuple[float, float] = (0.001, 0.01)
    start: tuple[float, float] = (0.02, 0.2)
    activate: float = 0.01
    state_size: int = 10_000
    keep: int = 50


Models = Mapping[str, ComponentModel]
"""Component -> its model; those that are not named have the default one."""


def drawn(choices: Choices, limits: tuple[float, float]) -> float:
    """Return a time from the shortest to the longest [s]."""
    return choices.between("components", *limits)
