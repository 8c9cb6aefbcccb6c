"""Whether another placement is worth its moves. Pure.

Gain is work that would be done and is not; the cost of a move is what its component
would have done meanwhile, and its start. docs/design/decisions.md has the rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.manage.adaptation.bad_links import (
    bad_links,
    beyond_cuts,
    reason,
    wasted,
    with_bad_links,
)
from poise.manage.adaptation.proposal import (
    STARVED,
    late,
    nothing_helps,
    problem_now,
    propose,
    share_what_is_left,
    terms_of,
    with_time_limits,
)
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.migration_report import Proposal
from poise.manage.migration.transition_plan import missing_cpu
from poise.manage.observe.estimates import DemandEstimate
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.model.software import importance
from poise.units import counted, format_cores

HORIZON = 30.0
"""The present load is expected to last for this time at least [s]."""
DOWNTIME = 0.05
"""The downtime of a component that was not moved yet is taken to be this [s]."""
START = 0.3
"""The CPU time to start a component is taken to be this, until it was measured [s]."""
WORTH = 0.01
"""What a unit of F is worth besides [core-seconds]: it only decides between placements
that leave the same work undone."""
_CROWDED = 0.9
"""A computer is crowded when components need this share of what it has for them."""
_URGENT, _MOST_URGENT = 1.1, 1.5
"""A late component on a crowded computer is counted with this many times its CPU."""
_BURST = 1.5
"""A component that uses this many times what it needs in the mean has a burst."""
_LEAST = 1e-6
"""A gain below this is none [cores]."""


class Decision(Struct, frozen=True, kw_only=True):
    """What is best done about symptoms."""

    acts: bool  # whether something should change; when, is up to `LossSuffered`
    why: str  # for people
    proposal: Proposal | None = None  # None: nothing is better than what is
    gain: float = 0.0  # work that would be done more, by priority [cores]
    cost: float = 0.0  # work that is lost by the moves [core-seconds]
    undone: float = 0.0  # work that is not done as it is [cores]


def decide(
    situation: Situation,
    horizon: float = HORIZON,  # the present load lasts for this time [s]
    doubt: float = 1.0,  # how many times costs count, >= 1
) -> Decision:
    """Return whether to change the placement, and why."""
    gone = _gone(situation)
    steady = situation.of_running_components()
    situation = with_bursts(steady)
    situation = replace(situation, urgency={**urgent(situation), **steady.urgency})
    bad = bad_links(situation)
    robot = _without_homes_beyond(
        beyond_cuts(situation.placement, bad), with_bad_links(situation.robot, bad)
    )
    situation = replace(situation, robot=robot)
    price = horizon / WORTH
    short = sum(shortages_of(situation).values())
    causes = reason(situation, bad)
    in_vain = wasted(situation, situation.placement, bad)
    is_old = any(chain.is_late for chain in situation.chains)
    if not short and not in_vain and not is_old:
        return Decision(acts=False, why=causes + nothing_helps(situation, gone))
    costs = move_costs(situation)
    try:
        proposal = propose(
            situation,
            costs={name: doubt * cost / WORTH for name, cost in costs.items()},
            price=price,
            is_quick=True,
        )
    except RobotError as error:
        why = f"no placement can help: {causes}{late(situation)}{error}"
        undone = _undone_now(situation, price) + in_vain
        return Decision(acts=False, why=why, undone=undone)
    now, then = _undone(proposal.now, price), _undone(proposal.then, price)
    undone = now + in_vain
    # differences first: what changes nothing gains 0
    gain = now - then + (in_vain - wasted(situation, proposal.placement, bad))
    cost = sum(costs[step.component] for step in proposal.steps)
    acts = bool(proposal.steps) and gain > _LEAST and gain * horizon > doubt * cost
    why = f"{causes}{_change(proposal, gain, cost)}"
    if not acts:
        # nothing loses its state for what is in time now, nor for a burst
        demands, now_late = steady.demand_estimates, urgent(steady)
        lasting = replace(situation, demand_estimates=demands, urgency=now_late)
        suspended = _with_fewer(lasting) if short else None
        if suspended is not None:
            return replace(suspended, undone=undone)
        why = f"it stays as it is: {why}"
        if short:
            why = _why_not(situation, causes, costs)
        elif is_old and not proposal.steps:
            why = causes + nothing_helps(situation, gone)
    return Decision(
        acts=acts, why=why, proposal=proposal, gain=gain, cost=cost, undone=undone
    )


def _undone(terms: plan.Terms, price: float) -> float:
    """Return what is not done for lack of CPU, or done too late [cores]."""
    return (terms.shortage + terms.time) / price


def _undone_now(situation: Situation, price: float) -> float:
    """Return the same as it is, where no placement was found."""
    try:
        problem = problem_now(situation)
    except RobotError:
        return sum(shortages_of(situation).values())
    problem = with_time_limits(problem, situation, price)
    problem = share_what_is_left(problem, situation, price)
    return _undone(terms_of(problem, situation.placement), price)


def _gone(situation: Situation) -> str:
    """Return which components are lost with their computers; empty: none."""
    names = [n for n, at in situation.placement.items() if at in situation.lost]
    return ", ".join(f"'{n}' of '{situation.placement[n]}'" for n in sorted(names))


def with_bursts(situation: Situation) -> Situation:
    """Return the situation with what components use now that make others late.

    Over half a minute a burst is little; while it fills its computer, it is not.
    """
    late = {timer.computer for timer in situation.misses if timer.late}
    full = {name: load for name, load in situation.loads.items() if load.is_full}

    def now(each: DemandEstimate) -> DemandEstimate:
        load = full.get(each.computer) if each.computer in late else None
        used = load.components.get(each.component, 0.0) if load else 0.0
        if used <= _BURST * each.estimate.mean:
            return each
        return replace(each, estimate=replace(each.estimate, mean=used, error=0.0))

    estimates = tuple(now(each) for each in situation.demand_estimates)
    return replace(situation, demand_estimates=estimates)


def urgent(situation: Situation) -> dict[str, float]:
    """Return how many times the CPU of late components counts that they be in time.

    Utilisation below 1 is not schedulability: on a crowded computer a component whose
    runs take longer than its deadline needs its CPU by that factor sooner.
    """
    robot = replace(situation, urgency={}).robot_now
    demands = robot.demands("cpu")
    used = dict.fromkeys((c.name for c in robot.computers), 0.0)
    for name, at in situation.placement.items():
        used[at] += demands[name]
    usable = {c.name: c.usable("cpu") for c in situation.computers_left()}
    crowded = {name for name, cores in used.items() if cores >= _CROWDED * usable[name]}
    return {
        timer.component: min(max(timer.takes / timer.deadline, _URGENT), _MOST_URGENT)
        for timer in situation.misses
        if timer.late
        and timer.takes >= _CROWDED * timer.deadline > 0
        and timer.computer in crowded
    }


def _change(proposal: Proposal, gain: float, cost: float) -> str:
    """Return what a change gains and costs, for people."""
    if not proposal.steps:
        return "no other placement is better"
    return (
        f"{counted(len(proposal.steps), 'step')}: {format_cores(gain)} of work more, "
        f"for {cost:.2f} core-seconds"
    )


def _why_not(situation: Situation, causes: str, costs: Mapping[str, float]) -> str:
    """Return whether any placement would help if moves cost nothing, for people."""
    free = propose(situation, price=plan.PRICE, is_quick=True)
    gain = (free.now.shortage - free.then.shortage) / plan.PRICE
    if gain <= _LEAST:
        return f"no placement can help: {causes}{late(situation)}{_room(situation)}"
    cost = sum(costs[step.component] for step in free.steps)
    return f"it stays as it is: {causes}{_change(free, gain, cost)}, not worth it"


def _room(situation: Situation) -> str:
    """Return what the components need and what there is for them, for people."""
    robot = situation.left().robot_now
    needed = sum(
        c.demand.get("cpu", 0.0)
        for c in robot.components()
        if c.name in situation.placement
    )
    usable = ", ".join(
        f"'{c.name}' has {format_cores(c.usable('cpu'))}" for c in robot.computers
    )
    short = ", ".join(
        f"{format_cores(cores)} on '{name}'"
        for name, cores in shortages_of(situation).items()
        if cores > 0
    )
    return (
        f"{short} are missing; components need {format_cores(needed)} in all; after "
        f"other programs and reserves {usable}; no move reduces the shortage"
    )


def _with_fewer(situation: Situation) -> Decision | None:
    """Return what to suspend for the sake of architectures of higher priority.

    CPU is short wherever components run, so the work of the lowest priorities is given
    up; but only when higher ones suffer in spite of their CPU weights where that helps.
    """
    suffers, robot = _suffering(situation), situation.robot
    try:
        proposal = propose(situation.left(), fewer=True, is_quick=True)
    except RobotError:
        return None
    suspended = {
        a.name: a.priority for a in robot.architectures if a.name in proposal.suspended
    }
    relieved = {step.source for step in proposal.steps}  # also of what moves
    helped = [
        a.priority
        for a in robot.architectures
        if a.name not in suspended
        and any(
            c.name in suffers and situation.placement.get(c.name) in relieved
            for c in a.components
        )
    ]
    if not suspended or not helped or max(suspended.values()) >= max(helped):
        return None
    names = ", ".join(f"'{n}' (priority {p})" for n, p in sorted(suspended.items()))
    return Decision(acts=True, why=f"not all fits without {names}", proposal=proposal)


def shortages_of(situation: Situation) -> dict[str, float]:
    """Return computer -> CPU that its components need and do not have [cores]."""
    left = situation.left()
    demands = {name: now.counted for name, now in left.shifted.items()}
    return missing_cpu(left.robot, left.placement, demands)


def _suffering(situation: Situation) -> set[str]:
    """Return the components that are starved, or miss deadlines."""
    starved = {
        demand.component
        for demand in situation.estimates_at_work()
        if demand.estimate.starved >= STARVED
    }
    return starved | {timer.component for timer in situation.misses if timer.late}


def move_costs(situation: Situation) -> dict[str, float]:
    """Return what it costs to move each component [core-seconds]."""
    robot = situation.robot_now
    counts = importance(a.priority for a in robot.architectures)
    starts = {c.name: c.start for c in components_of(situation.statuses) if c.start}
    return {
        c.name: starts.get(c.name, START)
        + counts[a.priority]
        * c.demand.get("cpu", 0.0)
        * situation.downtimes.get(c.name, DOWNTIME)
        for a in robot.architectures
        for c in a.components
    }


def _without_homes_beyond(cuts: Mapping[str, AbstractSet[str]], robot: Robot) -> Robot:
    """Return the robot whose components stay on their side of cut links."""
    if not cuts:
        return robot
    allowed = allowed_computers(robot)
    homes = {name: tuple(sorted(allowed[name] - away)) for name, away in cuts.items()}
    return robot.with_components(
        lambda c: replace(c, only=homes[c.name]) if homes.get(c.name) else c
    )
