"""Where components of lost computers restart. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.replan import SOLVE_FOR, with_present_demands
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import ComponentEntry, Robot


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
    movable = {c.name for c in facts.robot.components() if c.movable}
    missing: dict[str, str] = {}
    homes: dict[str, tuple[str, ...]] = {}
    for name, computer in facts.placement.items():
        choices = tuple(sorted(allowed[name] - set(lost)))
        if computer not in lost:
            homes[name] = (computer,)
        elif name not in movable:
            missing[name] = "it is not movable (robot file)"
        elif not choices:
            here = " or ".join(sorted(allowed[name]))
            missing[name] = f"it may run on {here} only"
        else:
            homes[name] = choices
    stranded = {name for name in homes if facts.placement[name] in lost}
    if not stranded:
        return Failover(placement={}, missing=missing)
    result = plan.solve(plan.problem_of(_what_is_left(facts, homes)), budget=SOLVE_FOR)
    if not result.feasible:
        why = f"it fits nowhere beside what runs: {result.reason}"
        missing |= dict.fromkeys(stranded, why)
        return Failover(placement={}, missing=missing)
    where = {name: result.placement[name] for name in stranded}
    return Failover(placement=where, missing=missing)


def _what_is_left(facts: Facts, homes: Mapping[str, tuple[str, ...]]) -> Robot:
    """Return the robot without what is lost, each component held to its homes."""
    robot = with_present_demands(facts.robot, facts.demand_estimates)
    used = {computer for choices in homes.values() for computer in choices}
    computers = tuple(c for c in facts.computers_left() if c.name in used)
    names = {computer.name for computer in computers}
    left = robot.with_components(lambda component: _homed(component, homes))
    return replace(
        left,
        computers=computers,
        links=tuple(k for k in robot.links if names.issuperset(k.between)),
        architectures=tuple(
            replace(each, layer="sequencing") for each in left.architectures
        ),
        tasks=(),
    )


def _homed(
    component: ComponentEntry, homes: Mapping[str, tuple[str, ...]]
) -> ComponentEntry | None:
    """Return a component held to its homes; None when it has none."""
    if component.name not in homes:
        return None
    return replace(component, only=homes[component.name], devices=(), movable=True)
