"""Computes a new placement for a running robot, from its present demands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from time import perf_counter

from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.estimate.demands import shifted_cpu_demand
from poise.manage.adaptation.proposals import PresentDemand, Proposal
from poise.manage.adaptation.situation import Situation
from poise.manage.migration.transition import plan_transition
from poise.manage.observe.estimates import DemandEstimate
from poise.model.robot import ComponentEntry, Computer, Robot

SOLVE_FOR = 0.1
"""The planner searches for so long [s]; small robots are proven optimal before."""
DECIDE_FOR = 0.015
"""It searches for so long while the robot waits for a decision [s]."""
EXPLAIN_FOR = 1.0
"""Why nothing fits is looked for about as long at most [s]."""


def propose(
    situation: Situation,
    robot: Robot,
    move: float,
    *,
    fewer: bool = False,
    is_quick: bool = False,
) -> Proposal:
    """Return a better placement for a running robot, and the way to it.

    Parameters
    ----------
    robot
        With the demands it was placed by.
    move
        What F grows by for every component that moves, plus as much for each MB of
        its state; >= 0.
    fewer
        Whether architectures are put aside by priority when not all fit.
    is_quick
        Whether the robot waits: then why nothing fits is not looked for.

    Raises
    ------
    RobotError
        The task fits nowhere with these demands, or there is no way to the placement.
    """
    task, now = situation.task, situation.placement
    shifted = dict(_shifted(robot, situation.demand_estimates))
    robot_now = _with_cpu(
        robot, {name: demand.counted for name, demand in shifted.items()}
    )
    problem = plan.problem_of(robot_now, task, present=now, move=move)
    # Of alternative architectures only one runs: keep to it.
    planner = plan.Planner(plan.keep_components(problem, now.keys()))
    budget = DECIDE_FOR if is_quick else SOLVE_FOR
    result = planner.decide(budget=budget, fewer=fewer)
    if not result.feasible or result.objective is None:
        if not is_quick:
            give_up_at = perf_counter() + EXPLAIN_FOR
            result.find_conflict(lambda: perf_counter() > give_up_at)
        needs = "".join(f"; {name} needs {demand}" for name, demand in shifted.items())
        raise RobotError(
            f"task '{task}' has no placement any more: {result.reason}{needs}"
        )
    present = plan.evaluate(planner.problem, now)
    assert present.objective is not None  # noqa: S101, a given placement has terms
    return Proposal(
        shifted=shifted,
        now=present.objective,
        then=result.objective,
        placement=result.placement,
        trouble=present.reason,
        steps=plan_transition(robot_now, now, result.placement),
        proven=result.proven,
        aside=result.aside,
    )


def with_present_demands(
    robot: Robot, demand_estimates: Iterable[DemandEstimate]
) -> Robot:
    """Return the robot with the CPU demands that its components have now [cores]."""
    shifted = _shifted(robot, demand_estimates)
    return _with_cpu(robot, {name: demand.counted for name, demand in shifted})


def _shifted(
    robot: Robot, demand_estimates: Iterable[DemandEstimate]
) -> Iterator[tuple[str, PresentDemand]]:
    """Give the demands that are not what was counted with: shifted, or too small."""
    components = {c.name: c for c in robot.components()}
    for each in demand_estimates:
        now, component = each.estimate, components.get(each.component)
        if component is None or now.error is None:
            continue
        demand = component.demand.get("cpu", 0.0)
        if now.drift is None and now.mean - now.error <= demand:
            continue
        needed = shifted_cpu_demand(demand, each.expected, now)
        most = max(_most(component, computer) for computer in robot.computers)
        yield (
            each.component,
            PresentDemand(
                mean=now.mean,
                error=now.error,
                counted=min(needed, most),
                is_bounded=needed > most,
            ),
        )


def _most(component: ComponentEntry, computer: Computer) -> float:
    """Return what a computer can give a component that is alone there [cores].

    One chain at a time runs a component's code, so that is one core at most; a command
    may use all.
    """
    usable = computer.usable("cpu")
    return usable if component.command else min(usable, computer.speed)


def _with_cpu(robot: Robot, demands: Mapping[str, float]) -> Robot:
    """Return the robot with other CPU demands [cores]."""
    if not demands:
        return robot
    return robot.with_components(
        lambda c: (
            replace(c, demand={**c.demand, "cpu": demands[c.name]})
            if c.name in demands
            else c
        )
    )
