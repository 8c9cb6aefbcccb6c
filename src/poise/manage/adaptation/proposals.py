"""What a person or the manager may do next: a better placement, or a single move."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.manage.migration.migration_report import TransitionStep
from poise.manage.observe.estimates import PresentDemand
from poise.plan.result_records import Terms


class Proposal(Struct, frozen=True, kw_only=True):
    """Where components should run now.

    Parameters
    ----------
    shifted
        Component -> what it needs now, where that has shifted or is more than was
        counted with.
    now, then
        F of the placement that is, and of the one proposed, for the same demands.
    trouble
        Which limits the placement that is breaks; empty when it keeps all.
    steps
        From the one to the other; none when it is best to stay.
    proven
        Whether no placement is better.
    suspended
        The architectures that are suspended: not all fits.
    """

    shifted: Mapping[str, PresentDemand]
    now: Terms
    then: Terms
    placement: Mapping[str, str]
    trouble: str = ""
    steps: tuple[TransitionStep, ...] = ()
    proven: bool = False
    suspended: tuple[str, ...] = ()


class WhatIf(Struct, frozen=True, tag=True, kw_only=True):
    """What a move would change, for the demands that components have now.

    Parameters
    ----------
    now, then
        F before and after the move.
    breaks
        The limits that it would break: then it is refused, unless it is forced.
    trouble
        Which limits are broken as it is; empty: none.
    loads
        Computer -> the CPU that its components need, before and after [cores].
    usable
        Computer -> the CPU that there is for them [cores].
    downtime
        For how long the component would be paused [s]: as in its last move, else a
        guess.
    cost
        Work that the move would cost [core-seconds].
    state
        Size of its snapshot, if that was ever taken [bytes].
    """

    component: str
    source: str
    target: str
    now: Terms
    then: Terms
    breaks: tuple[str, ...] = ()
    trouble: str = ""
    loads: Mapping[str, tuple[float, float]] = {}
    usable: Mapping[str, float] = {}
    downtime: float
    cost: float = 0.0
    state: int = 0
