"""Whether a component may move to a computer, by the planner's limits."""

from __future__ import annotations

from collections.abc import Mapping

from poise import plan
from poise.errors import UsageError
from poise.model.robot import Robot


def check_move(
    robot: Robot, placement: Mapping[str, str], component: str, computer: str
) -> None:
    """Raise UsageError when a component does not fit on a computer beside what runs.

    Limits that are broken without it do not count.

    Parameters
    ----------
    robot
        With the demands that count.
    placement
        Component -> computer, as it is.
    """
    if component not in placement or computer not in {h.name for h in robot.computers}:
        return  # the move itself says so
    if new := new_breaks(robot, placement, component, computer):
        raise UsageError(
            f"component '{component}' does not fit on '{computer}' ({'; '.join(new)}); "
            "`--force` moves it nevertheless"
        )


def new_breaks(
    robot: Robot, placement: Mapping[str, str], component: str, computer: str
) -> list[str]:
    """Return the limits that a component would break there, in the planner's words."""
    others = {name: at for name, at in placement.items() if name != component}
    before = _broken(robot, others)
    after = _broken(robot, {**others, component: computer})
    return [limit for limit in after if limit not in before]


def _broken(robot: Robot, placement: Mapping[str, str]) -> list[str]:
    """Return the limits that a placement breaks, in the planner's words."""
    if not placement:
        return []
    problem = plan.keep_components(plan.problem_of(robot), placement.keys())
    reason = plan.evaluate(problem, placement).reason
    return reason.split("; ") if reason else []
