"""Whether another placement is worth its moves. Pure.

Gain and cost are work that is not done [core-seconds]: what computers are short of now
and would not be there, and what is computed in vain, over the horizon, because chains
are late or connectors cross links that are cut or slow; against
what the components that move would have done meanwhile, and the CPU time of starting
them there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import RobotError
from poise.manage.adaptation.bad_links import (
    bad_links,
    beyond_cuts,
    reason,
    wasted,
    with_bad_links,
)
from poise.manage.adaptation.late_data import late, relieve
from poise.manage.adaptation.proposals import Proposal
from poise.manage.adaptation.replan import propose, with_present_demands
from poise.manage.adaptation.situation import Homes, Situation
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.report import TransitionStep
from poise.manage.migration.residue import missing_cpu
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.units import counted, format_cores

HORIZON = 30.0
"""The present load is expected to last for this time [s]."""
DOWNTIME = 0.05
"""The downtime of a component that was not moved yet is taken to be this [s]."""
START = 0.3
"""The CPU time to start a component is taken to be this, until it was measured [s]."""
STARVED = 0.1
"""A component suffers when it does not do this share of its jobs."""
MOVE = 0.001
"""What F grows by for each move: of placements that mend the same, few moves win."""


class Decision(Struct, frozen=True, kw_only=True):
    """What is done about symptoms.

    Parameters
    ----------
    proposal
        Where the components should run; None: there is nothing better.
    acts
        Whether it is carried out.
    why
        A sentence for people.
    gain, cost
        Work that would be done more, and less [core-seconds].
    """

    acts: bool
    why: str
    proposal: Proposal | None = None
    gain: float = 0.0
    cost: float = 0.0


def decide(
    situation: Situation, barred: Mapping[str, AbstractSet[str]] = {}
) -> Decision:
    """Return whether to change the placement, and why.

    Parameters
    ----------
    barred
        Component -> computers where it may not go.
    """
    situation = situation.within_reach()
    bad = bad_links(situation)
    barred = beyond_cuts(barred, situation.placement, bad)
    robot = with_bad_links(situation.robot_left(), bad)
    robot_now = with_present_demands(robot, situation.demand_estimates)
    short = sum(missing_cpu(robot_now, situation.placement).values())
    robot = _barring(robot, situation.placement, barred)
    causes = reason(situation, bad)
    in_vain = wasted(situation, robot_now, situation.placement, bad)
    relieved = 0.0
    if not short:
        relief = relieve(robot, situation, barred)
        if not relief.homes and not in_vain:
            return Decision(acts=False, why=causes + relief.why)
        robot, relieved = _held(robot, relief.homes), relief.wasted
    try:
        proposal = propose(situation, robot, MOVE, is_quick=True)
    except RobotError as error:
        room = _room(robot_now, situation)
        why = f"no placement can help: {causes}{late(situation)}{error}{room}"
        unable = Decision(acts=False, why=why)
        return _with_fewer(robot, situation, unable) if short else unable
    left = sum(missing_cpu(robot_now, proposal.placement).values())
    in_vain -= wasted(situation, robot_now, proposal.placement, bad)
    gain = (short - left + relieved + in_vain) * HORIZON
    cost = cost_of(situation, robot_now, proposal.steps)
    what = f"{causes}no other placement is better"
    if proposal.steps:
        what = (
            f"{causes}{counted(len(proposal.steps), 'step')}: cost {cost:.2f} "
            f"core-seconds, gain {gain:.2f} within {HORIZON:g} s"
        )
    acts = bool(proposal.steps) and gain > cost
    why = what if acts else f"it stays as it is: {what}"
    return Decision(acts=acts, why=why, proposal=proposal, gain=gain, cost=cost)


def _held(robot: Robot, homes: Homes) -> Robot:
    """Return the robot with components held to their homes, where they have any."""
    return robot.with_components(
        lambda c: replace(c, only=homes[c.name]) if homes.get(c.name) else c
    )


def _room(robot: Robot, situation: Situation) -> str:
    """Return what the components need and what there is for them, for people."""
    needed = sum(
        c.demand.get("cpu", 0.0)
        for c in robot.components()
        if c.name in situation.placement
    )
    usable = ", ".join(
        f"'{c.name}' has {format_cores(c.usable('cpu'))}" for c in robot.computers
    )
    return (
        f"; they need {format_cores(needed)} in all, and beside other programs and "
        f"reserves {usable} (`poise balance --dry-run` looks for the limits in the way)"
    )


def _with_fewer(robot: Robot, situation: Situation, unable: Decision) -> Decision:
    """Return whether to put aside architectures for the sake of higher ones.

    Not all fits, so the work of the lowest priorities is given up; but only when
    higher ones suffer in spite of their CPU weights.
    """
    try:
        proposal = propose(situation, robot, MOVE, fewer=True, is_quick=True)
    except RobotError:
        return unable
    aside = {
        a.name: a.priority for a in robot.architectures if a.name in proposal.aside
    }
    suffers = _suffering(situation)
    helped = [
        a.priority
        for a in robot.architectures
        if a.name not in aside and any(c.name in suffers for c in a.components)
    ]
    if not aside or not helped or max(aside.values()) >= max(helped):
        return unable
    names = ", ".join(f"'{n}' (priority {p})" for n, p in sorted(aside.items()))
    return Decision(acts=True, why=f"not all fits without {names}", proposal=proposal)


def shortages_of(situation: Situation) -> dict[str, float]:
    """Return what components of each computer need and it does not have [cores]."""
    robot = with_present_demands(situation.robot_left(), situation.demand_estimates)
    return missing_cpu(robot, situation.placement)


def _suffering(situation: Situation) -> set[str]:
    """Return the components that are starved, or miss deadlines."""
    starved = {
        each.component
        for each in situation.demand_estimates
        if each.estimate.starved >= STARVED
    }
    return starved | {each.component for each in situation.misses if each.late}


def cost_of(
    situation: Situation, robot: Robot, steps: Iterable[TransitionStep]
) -> float:
    """Return what steps cost [core-seconds].

    Parameters
    ----------
    robot
        With the present demands.
    """
    demands = {c.name: c.demand.get("cpu", 0.0) for c in robot.components()}
    starts = {c.name: c.start for c in components_of(situation.statuses) if c.start}
    return sum(
        starts.get(step.component, START)
        + demands[step.component] * situation.downtimes.get(step.component, DOWNTIME)
        for step in steps
    )


def _barring(
    robot: Robot, placement: Mapping[str, str], barred: Mapping[str, AbstractSet[str]]
) -> Robot:
    """Return the robot whose components may not go where they are barred from."""
    if not barred:
        return robot
    allowed = allowed_computers(robot)
    homes = {
        name: tuple(
            computer
            for computer in sorted(allowed[name])
            if computer not in computers or computer == placement.get(name)
        )
        for name, computers in barred.items()
    }
    return _held(robot, homes)
