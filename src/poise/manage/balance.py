"""Places a running robot anew, from what its components turned out to need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.estimate.rule import shifted_cpu_demand
from poise.manage.estimates import Standing
from poise.manage.transition import Placement, Step, plan_transition
from poise.model.robot import Robot

SOLVE_FOR = 0.1
"""The planner searches for so long [s]; small robots are proven optimal before."""


class Proposal(Struct, frozen=True, kw_only=True):
    """Where components should run now.

    Parameters
    ----------
    shifted
        Component -> its CPU demand as it is now [cores], where that has shifted or is
        more than was counted with.
    now, then
        F of the placement that is, and of the one proposed, for the same demands.
    trouble
        Which limits the placement that is breaks; empty when it keeps all.
    steps
        From the one to the other; none when it is best to stay.
    proven
        Whether no placement is better.
    """

    shifted: Mapping[str, float]
    now: plan.Terms
    then: plan.Terms
    placement: Placement
    trouble: str = ""
    steps: tuple[Step, ...] = ()
    proven: bool = False


def propose(
    robot: Robot,
    task: str,
    now: Placement,
    standings: Iterable[Standing],
    move: float,
) -> Proposal:
    """Return a better placement for a running robot, and the way to it.

    Parameters
    ----------
    robot
        With the demands it was placed by.
    now
        Component -> computer.
    standings
        What the components need now.
    move
        What F grows by for every component that moves, plus as much for each MB of
        its state; >= 0.

    Raises
    ------
    RobotError
        The task fits nowhere with these demands, or there is no way to the placement.
    """
    shifted = _shifted(robot, standings)
    needy = _with_cpu(robot, shifted)
    problem = plan.problem_of(needy, task, present=now, move=move)
    is_placed = {component.name for component in problem.components} <= now.keys()
    if not is_placed:  # of alternative architectures only one runs: keep to it
        problem = plan.keep_components(problem, now.keys())
    result = plan.solve(problem, SOLVE_FOR)
    if not result.feasible or result.objective is None:
        raise RobotError(f"task '{task}' has no placement any more: {result.reason}")
    present = plan.evaluate(problem, now)
    assert present.objective is not None  # noqa: S101, a given placement has terms
    return Proposal(
        shifted=shifted,
        now=present.objective,
        then=result.objective,
        placement=result.placement,
        trouble=present.reason,
        steps=plan_transition(needy, now, result.placement),
        proven=result.proven,
    )


def _shifted(robot: Robot, standings: Iterable[Standing]) -> dict[str, float]:
    """Return the demands that are not what was counted with: shifted, or too small."""
    demands = {c.name: c.demand.get("cpu", 0.0) for c in robot.components()}
    shifted = {}
    for each in standings:
        now, demand = each.estimate, demands.get(each.component)
        if demand is None or now.error is None:
            continue
        if now.drift is not None or now.mean - now.error > demand:
            shifted[each.component] = shifted_cpu_demand(demand, each.expected, now)
    return shifted


def _with_cpu(robot: Robot, demands: Mapping[str, float]) -> Robot:
    """Return the robot with other CPU demands [cores]."""
    return replace(
        robot,
        architectures=tuple(
            replace(
                architecture,
                components=tuple(
                    replace(c, demand={**c.demand, "cpu": demands[c.name]})
                    if c.name in demands
                    else c
                    for c in architecture.components
                ),
            )
            for architecture in robot.architectures
        ),
    )
