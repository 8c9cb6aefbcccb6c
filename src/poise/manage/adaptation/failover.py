"""Where components of lost computers restart. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct

from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.room import placed_beside
from poise.model.check.allowed_computers import allowed_computers
from poise.model.pinned import pinned_components
from poise.model.robot import Robot


class Failover(Struct, frozen=True, kw_only=True):
    """What becomes of the components of lost computers.

    Parameters
    ----------
    placement
        Component -> the computer where it restarts.
    missing
        Component -> why it runs nowhere until its computer is back.
    waits_for_room
        Whether some would run elsewhere if there were room: those of low priority.
    """

    placement: Mapping[str, str]
    missing: Mapping[str, str]
    waits_for_room: bool = False


def fail_over(facts: Facts, lost: Collection[str]) -> Failover:
    """Return where the components of lost computers can run; all others stay.

    Parameters
    ----------
    lost
        Computers that are out of reach.
    """
    allowed = allowed_computers(facts.robot)
    pinned = pinned_components(facts.robot)
    missing: dict[str, str] = {}
    homes: dict[str, tuple[str, ...]] = {}
    for name, computer in facts.placement.items():
        choices = tuple(sorted(allowed[name] - set(lost)))
        if computer not in lost:
            homes[name] = (computer,)
        elif name in pinned:
            missing[name] = pinned[name]
        elif not choices:
            here = " or ".join(sorted(allowed[name]))
            missing[name] = f"it may run on {here} only"
        else:
            homes[name] = choices
    stranded = {name for name in homes if facts.placement[name] in lost}
    if not stranded:
        return Failover(placement={}, missing=missing)
    unfit: set[str] = set()
    while stranded:
        result = placed_beside(facts, homes)
        if result.feasible:
            break
        least = _of_lowest_priority(facts.robot, stranded)
        why = f"it fits nowhere beside what runs: {result.reason}"
        missing |= dict.fromkeys(least, why)
        unfit |= least
        stranded -= least
        homes = {name: where for name, where in homes.items() if name not in least}
    return Failover(
        placement={name: result.placement[name] for name in stranded},
        missing=missing,
        waits_for_room=bool(unfit),
    )


def _of_lowest_priority(robot: Robot, stranded: Collection[str]) -> set[str]:
    """Return the components of the architecture that is dropped first."""
    affected = [
        (architecture.priority, {c.name for c in architecture.components} & {*stranded})
        for architecture in robot.architectures
    ]
    return min((each for each in affected if each[1]), key=lambda each: each[0])[1]
