"""Where components fit beside what runs. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.manage.adaptation.replan import SOLVE_FOR, with_present_demands
from poise.manage.adaptation.situation import Homes, Situation
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import ComponentEntry, Robot


def placed_beside(
    situation: Situation, homes: Homes, *, is_cautious: bool = False
) -> plan.Result:
    """Return where components fit; those without homes do not count.

    Parameters
    ----------
    is_cautious
        Whether other programs are reckoned to want more on every computer, so that what
        is started now need not be stopped again.

    Raises
    ------
    RobotError
        A component can run nowhere.
    """
    problem = plan.problem_of(_what_is_left(situation, homes, is_cautious=is_cautious))
    fixed = {a.name for a in situation.robot.architectures if a.layer != "sequencing"}
    bundles = tuple(
        replace(bundle, required=bundle.name in fixed)
        for bundle in problem.architectures
    )
    problem = replace(problem, architectures=bundles)
    return plan.solve(problem, budget=SOLVE_FOR, steps=situation.solve_steps)


def room_for_components(
    situation: Situation, components: Collection[str], not_on: Collection[str] = ()
) -> Mapping[str, str]:
    """Return where components fit beside all others; empty: they do not.

    Parameters
    ----------
    not_on
        Computers where they must not be.
    """
    allowed = allowed_computers(situation.robot)
    homes: dict[str, tuple[str, ...]] = {
        n: (at,) for n, at in situation.placement.items() if at not in situation.lost
    }
    for name in components:
        homes[name] = tuple(sorted(allowed[name] - situation.lost - set(not_on)))
        if not homes[name]:
            return {}
    try:
        result = placed_beside(situation, homes, is_cautious=True)
    except RobotError:
        return {}
    return {n: at for n, at in result.placement.items() if n in components}


def _what_is_left(situation: Situation, homes: Homes, *, is_cautious: bool) -> Robot:
    """Return the robot without what is lost, each component held to its homes."""
    robot = with_present_demands(situation.robot, situation.demand_estimates)
    used = {computer for choices in homes.values() for computer in choices}
    left = situation.computers_left(is_cautious=is_cautious)
    computers = tuple(c for c in left if c.name in used)
    names = {computer.name for computer in computers}
    kept = robot.with_components(lambda component: _homed(component, homes))
    return replace(
        kept,
        computers=computers,
        links=tuple(k for k in robot.links if names.issuperset(k.between)),
        architectures=tuple(
            replace(each, layer="sequencing") for each in kept.architectures
        ),
        tasks=(),
    )


def _homed(component: ComponentEntry, homes: Homes) -> ComponentEntry | None:
    """Return a component held to its homes; None when it has none."""
    if component.name not in homes:
        return None
    return replace(component, only=homes[component.name], devices=(), movable=True)
