"""Where components fit beside the running components. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.manage.adaptation.decision import HORIZON, WORTH, move_costs
from poise.manage.adaptation.proposal import (
    DECIDE_FOR,
    SOLVE_FOR,
    share_what_is_left,
    with_costs,
)
from poise.manage.adaptation.situation import Homes, Situation
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import ComponentEntry, Computer, Robot


def placed_beside(situation: Situation, homes: Homes) -> plan.Result:
    """Return where components run with least work undone; CPU that is short is shared.

    Those without homes do not count. To move one that works on one of its homes costs
    what it would have done meanwhile.
    """
    robot = _what_is_left(situation, homes, situation.robot.computers)
    problem = _problem_of(situation, robot)
    here = replace(situation, robot=robot, demand_estimates=())
    costs = {
        name: cost / WORTH
        for name, cost in move_costs(here).items()
        if situation.placement.get(name) in homes[name]
    }
    problem = with_costs(problem, costs)
    problem = share_what_is_left(problem, situation, HORIZON / WORTH)
    return plan.solve(problem, DECIDE_FOR, steps=situation.solve_steps, why=False)


def room_for_components(
    situation: Situation, components: Collection[str], not_on: Collection[str] = ()
) -> Mapping[str, str]:
    """Return where components fit beside all others; empty: they do not."""
    allowed = allowed_computers(situation.robot)
    homes: dict[str, tuple[str, ...]] = {
        n: (at,) for n, at in situation.placement.items() if at not in situation.lost
    }
    for name in components:
        homes[name] = tuple(sorted(allowed[name] - situation.lost - set(not_on)))
        if not homes[name]:
            return {}
    # other programs may want more: so what is started now need not be stopped again
    left = situation.computers_left(is_cautious=True)
    try:
        problem = _problem_of(situation, _what_is_left(situation, homes, left))
    except RobotError:
        return {}
    result = plan.solve(problem, SOLVE_FOR, steps=situation.solve_steps, why=False)
    return {n: at for n, at in result.placement.items() if n in components}


def _problem_of(situation: Situation, robot: Robot) -> plan.Problem:
    """Return the problem of placing all components of what is left of the robot."""
    problem = plan.problem_of(robot, present=situation.placement)
    fixed = {a.name for a in situation.robot.architectures if a.layer != "sequencing"}
    bundles = (replace(b, required=b.name in fixed) for b in problem.architectures)
    return replace(problem, architectures=tuple(bundles))


def _what_is_left(
    situation: Situation, homes: Homes, computers: Iterable[Computer]
) -> Robot:
    """Return the robot without what is lost, each component held to its homes."""
    used = {computer for choices in homes.values() for computer in choices}

    def homed(component: ComponentEntry) -> ComponentEntry | None:
        if component.name not in homes:
            return None
        return replace(component, only=homes[component.name], devices=(), movable=True)

    robot = situation.robot_now.with_components(homed)
    moving = (replace(a, layer="sequencing") for a in robot.architectures)
    here = robot.on(c for c in computers if c.name in used)
    return replace(here, architectures=tuple(moving), tasks=())
