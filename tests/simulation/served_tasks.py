"""What the tasks of a simulated robot need: it runs, once, where it may, or is said."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from poise.manage.control_socket.commands import RobotStatus
from poise.manage.tasks.task_reports import TaskReport
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot

_LATE = 3.0
"""An action whose limit is over ends within this time [s]."""


def unserved(robot: Robot, status: RobotStatus) -> list[str]:
    """Return what is wrong with the tasks and the placement of a status, in words."""
    return [*_placed_wrongly(robot, status), *_missing(robot, status)]


def _placed_wrongly(robot: Robot, status: RobotStatus) -> Iterator[str]:
    allowed = allowed_computers(robot)
    for name, at in sorted(status.placement.items()):
        if at not in allowed[name]:
            yield f"'{name}' is placed on '{at}', where it may not run"
    used = {f for task in status.tasks for f in _functions(task)}
    for function in sorted({a.function for a in robot.architectures}):
        begun = [
            a.name
            for a in robot.architectures
            if a.function == function
            and any(c.name in status.placement for c in a.components)
        ]
        if len(begun) > 1:
            yield f"'{function}' is provided by {' and by '.join(begun)}"
        if begun and function not in used:
            yield f"'{begun[0]}' runs, and no task uses '{function}'"


def _missing(robot: Robot, status: RobotStatus) -> Iterator[str]:
    whole = {a.function for a in robot.whole(status.placement)}
    actions = list(robot.actions())
    said = " ".join(deviation.what for deviation in status.deviations)
    for task in status.tasks:
        for action in task.actions if task.state == "going" else ():
            for function in action.functions:
                names = {a.name for a in robot.architectures if a.function == function}
                is_said = f"'{function}'" in said or any(
                    f"'{name}'" in said for name in names
                )
                if action.is_at_work and function not in whole and not is_said:
                    what = f"action '{action.name}' of task '{task.name}'"
                    yield f"{what} lacks '{function}', and nothing says so"
            name = action.name.rpartition(".")[2]  # another task may have it, too
            limit = max(a.limit or inf for a in actions if a.name == name)
            if action.worked > limit + _LATE:
                yield f"action '{action.name}' has worked for {action.worked:.1f} s"


def _functions(task: TaskReport) -> Iterator[str]:
    if task.state == "going":
        for action in task.actions:
            yield from action.functions
