"""Where the components of the next actions would run: the plan over time. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct

from poise import plan
from poise.errors import PoiseError
from poise.manage.tasks.progress import TaskRecord, Try
from poise.model.robot import Robot

PLAN_FOR = 0.3
"""The phases of a task are placed within this time [s], when it is planned first."""


class Likely(Struct, frozen=True, kw_only=True):
    """Components that may be needed soon.

    Parameters
    ----------
    action
        Which action needs them, as in phases.
    placement
        Component -> computer, without what runs already.
    probability
        That this action comes next in its task.
    """

    task: str
    action: str
    placement: Mapping[str, str]
    probability: float


class PlanOverTime:
    """The placements of the phases of a robot's tasks, made when first asked for.

    Parameters
    ----------
    solve_steps
        How much the planner searches; None: as its time allows.
    """

    def __init__(self, robot: Robot, solve_steps: int | None = None) -> None:
        self._robot = robot
        self._steps = solve_steps
        self._phases: dict[str, plan.PhasedResult | None] = {}

    def placement(
        self, task: str, actions: tuple[str, ...], functions: tuple[str, ...]
    ) -> Mapping[str, str]:
        """Return where what provides functions runs while actions do.

        Empty when the plan does not know. Of several phases with these actions the
        first counts.

        Parameters
        ----------
        actions
            Their names, as in phases.
        """
        result = self._of(task)
        wanted = self._robot.components_for(functions)
        for name, phase in result.results.items() if result else ():
            if set(actions) <= set(name.split("+")):
                return {n: at for n, at in phase.placement.items() if n in wanted}
        return {}

    def _of(self, task: str) -> plan.PhasedResult | None:
        if task not in self._phases:
            try:
                problem = plan.phased_problem_of(self._robot, task)
                result = plan.solve_phases(
                    problem, PLAN_FOR, steps=self._steps, why=False
                )
            except PoiseError:  # where it is needed, the reason is said
                self._phases[task] = None
            else:
                self._phases[task] = result
        return self._phases[task]


def likely_next(
    ahead: Iterable[tuple[TaskRecord, Try, float]],
    plans: PlanOverTime,
    running: Mapping[str, str],
    resting: Mapping[str, str],
) -> list[Likely]:
    """Return what may be needed next and does not run, the most probable first.

    Parameters
    ----------
    ahead
        The actions that may come next, with their probabilities.
    running
        Component -> computer, of what is at work.
    resting
        The same of what is prepared: there it stays.
    """
    found = []
    for record, each, probability in ahead:
        placement = plans.placement(record.name, (each.name,), each.action.functions)
        missing = {
            n: resting.get(n, at) for n, at in placement.items() if n not in running
        }
        if missing:
            found.append(
                Likely(
                    task=record.name,
                    action=each.name,
                    placement=missing,
                    probability=probability,
                )
            )
    return sorted(found, key=lambda each: -each.probability)
