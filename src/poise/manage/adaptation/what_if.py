"""What a move would change, before anything happens. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise import plan
from poise.errors import UsageError
from poise.manage.adaptation.admission import new_breaks
from poise.manage.adaptation.decision import DOWNTIME, cost_of, starts_of
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.replan import with_present_demands
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.transition import TransitionStep


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
    now: plan.Terms
    then: plan.Terms
    breaks: tuple[str, ...] = ()
    trouble: str = ""
    loads: Mapping[str, tuple[float, float]] = {}
    usable: Mapping[str, float] = {}
    downtime: float = DOWNTIME
    cost: float = 0.0
    state: int = 0


def what_if(
    facts: Facts, component: str, computer: str, downtimes: Mapping[str, float]
) -> WhatIf:
    """Return what a move would change.

    Parameters
    ----------
    downtimes
        Component -> the downtime of its last move [s].

    Raises
    ------
    UsageError
        There is no such component or computer, or it runs there.
    """
    before = facts.placement
    computers = {c.name: c for c in facts.robot.computers}
    if component not in before:
        raise UsageError(f"component '{component}' does not run")
    if computer not in computers:
        raise UsageError(f"there is no computer '{computer}': {', '.join(computers)}")
    source, after = before[component], {**before, component: computer}
    if source == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    robot = with_present_demands(facts.robot, facts.demand_estimates)
    problem = plan.keep_components(plan.problem_of(robot), before.keys())
    now, then = plan.evaluate(problem, before), plan.evaluate(problem, after)
    assert now.objective is not None  # noqa: S101, a given placement has terms
    assert then.objective is not None  # noqa: S101, the same
    step = TransitionStep(
        kind="move", component=component, source=source, target=computer
    )
    demands = {c.name: c.demand.get("cpu", 0.0) for c in robot.components()}
    sizes = {c.name: c.snapshot for c in components_of(facts.statuses)}
    return WhatIf(
        component=component,
        source=source,
        target=computer,
        now=now.objective,
        then=then.objective,
        breaks=tuple(new_breaks(robot, before, component, computer)),
        trouble=now.reason,
        loads={
            name: (_load(demands, before, name), _load(demands, after, name))
            for name in (source, computer)
        },
        usable={name: computers[name].usable("cpu") for name in (source, computer)},
        downtime=downtimes.get(component, DOWNTIME),
        cost=cost_of(robot, [step], downtimes, starts_of(facts)),
        state=sizes.get(component, 0),
    )


def _load(
    demands: Mapping[str, float], placement: Mapping[str, str], computer: str
) -> float:
    return sum(demands[name] for name, at in placement.items() if at == computer)
