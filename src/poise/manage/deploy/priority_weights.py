"""From the priorities of architectures to the CPU weights of their containers. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import Struct

from poise.model.priorities import importance
from poise.model.robot import Robot
from poise.model.tasks.steps import actions_of

USUAL = 100
"""The weight of the lowest priority: that of any other program."""
_LESS_A_STEP = 1.25
"""A thread that is nicer by 1 gets about this times less CPU."""
_NICEST = 19


class CpuWeight(Struct, frozen=True):
    """The share of the CPU of a container, when that is not enough for all."""

    weight: int = 0  # as cgroups have it, in [1, 10000]; 0: all containers are alike
    # of its threads, where there are no cgroups; 0 for the highest priority
    nice: int = 0


def cpu_weights(robot: Robot) -> Mapping[str, CpuWeight]:
    """Return architecture -> CPU weight; only the order of priorities counts.

    What is prepared for a later action has none: so where there may be such, others
    have one though all priorities are equal.
    """
    counts = importance(a.priority for a in robot.architectures)
    if len(counts) < 2:  # noqa: PLR2004 - nothing is above anything
        alike = CpuWeight(USUAL if _may_prepare(robot) else 0)
        return {a.name: alike for a in robot.architectures}
    most = max(counts.values())
    weights = {
        priority: CpuWeight(
            round(USUAL * times),
            min(round(math.log(most / times) / math.log(_LESS_A_STEP)), _NICEST),
        )
        for priority, times in counts.items()
    }
    return {a.name: weights[a.priority] for a in robot.architectures}


def _may_prepare(robot: Robot) -> bool:
    tasks = {task.name: task for task in robot.tasks}
    actions = [action for name in tasks for action in actions_of(tasks, name)]
    return not robot.prefetch.off and len(actions) > 1
