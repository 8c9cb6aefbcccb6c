"""Where components of lost computers restart. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct

from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.room import placed_beside
from poise.model.check.allowed_computers import allowed_computers
from poise.model.pinned import pinned_components


class Failover(Struct, frozen=True, kw_only=True):
    """What becomes of the components of lost computers.

    Parameters
    ----------
    placement
        Component -> the computer where it restarts.
    missing
        Component -> why it runs nowhere until its computer is back.
    """

    placement: Mapping[str, str]
    missing: Mapping[str, str]


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
    result = placed_beside(facts, homes)
    if not result.feasible:
        why = f"it fits nowhere beside what runs: {result.reason}"
        missing |= dict.fromkeys(stranded, why)
        return Failover(placement={}, missing=missing)
    where = {name: result.placement[name] for name in stranded}
    return Failover(placement=where, missing=missing)
