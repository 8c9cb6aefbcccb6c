"""Where components of lost computers restart. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from msgspec import Struct

from poise.manage.adaptation.facts import Facts, Homes
from poise.manage.adaptation.shortages.free_room import placed_beside
from poise.model.check.allowed_computers import allowed_computers
from poise.model.pinned import pinned_components
from poise.model.robot import Architecture


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
    aside
        Architectures that are put aside before, to make room for higher ones.
    """

    placement: Mapping[str, str]
    missing: Mapping[str, str]
    waits_for_room: bool = False
    aside: tuple[str, ...] = ()


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
        return _by_priority(facts, homes, stranded, missing)
    where = {name: result.placement[name] for name in stranded}
    return Failover(placement=where, missing=missing)


def _by_priority(
    facts: Facts, homes: Homes, stranded: Collection[str], missing: Mapping[str, str]
) -> Failover:
    """Return what fits of the stranded, the highest priority first.

    Architectures that run are put aside for higher ones only.
    """
    kept = {name: at for name, at in homes.items() if name not in stranded}
    placement: dict[str, str] = {}
    aside: tuple[str, ...] = ()
    missing = dict(missing)
    for architecture in sorted(facts.robot.architectures, key=lambda a: -a.priority):
        names = {c.name for c in architecture.components} & set(stranded)
        if not names:
            continue
        wanted = {name: homes[name] for name in names}
        why = ""
        for lower in _more_and_more(facts, architecture.priority, kept):
            gone = {c.name for a in lower for c in a.components}
            left = {name: at for name, at in kept.items() if name not in gone}
            result = placed_beside(facts, {**left, **wanted})
            if result.feasible:
                where = {name: result.placement[name] for name in names}
                placement |= where
                kept = {**left, **{name: (at,) for name, at in where.items()}}
                aside += tuple(a.name for a in lower)
                break
            why = f"it fits nowhere beside what runs: {result.reason}"
        else:
            missing |= dict.fromkeys(names, why)
    return Failover(
        placement=placement,
        missing=missing,
        aside=aside,
        waits_for_room=placement.keys() != set(stranded),
    )


def _more_and_more(
    facts: Facts, priority: int, kept: Homes
) -> Iterator[tuple[Architecture, ...]]:
    """Yield which of the running architectures of less priority make room."""
    lower = sorted(
        (
            a
            for a in facts.robot.architectures
            if a.layer == "sequencing"
            and a.priority < priority
            and any(c.name in kept for c in a.components)
        ),
        key=lambda a: a.priority,
    )
    for number in range(len(lower) + 1):
        yield tuple(lower[:number])
