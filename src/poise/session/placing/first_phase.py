"""What runs first when tasks are started together, and where."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from poise import plan
from poise.clock import boot_time
from poise.errors import RobotError
from poise.estimate.success.learning import WELL
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.learned_choice import choose
from poise.model.robot import Robot
from poise.plan.solvers.portfolio import METHODS as SOLVERS
from poise.session.callbacks import Say
from poise.session.placing.placement import Placement, place


class FirstPhase(Struct, frozen=True):
    """Tasks that are started, and the placement of what their first actions need."""

    tasks: Tasks
    placed: Placement

    def aside(self) -> frozenset[str]:
        """Return the functions that do not run, because not all fits."""
        aside = self.placed.result.aside
        bundles = self.placed.problem.architectures
        return frozenset(b.function for b in bundles if b.name in aside)


def first_phase(
    robot: Robot, tasks: Sequence[str], placement: Placement | None, say: Say
) -> FirstPhase:
    """Start tasks, and place what their first actions need.

    Architectures of low priority are put aside when not all fits.

    Parameters
    ----------
    placement
        Of one task, when it is decided already.

    Raises
    ------
    UsageError
        There is no such task.
    RobotError
        There is no placement; the message says why.
    """
    started = Tasks(robot, say, lambda c, _: choose(robot, c, WELL, say))
    now = boot_time()
    for name in tasks:
        started.start(name, now)
    started.arbitrate(now)
    started.announce()
    first, *others = started.going()
    chosen = placement or place(robot, first.name, fewer=True)
    if chosen.phased.reason and len(chosen.phases) > 1:
        say(f"not all of task '{first.name}' fits: {chosen.phased.reason}")
    name = "+".join(each.name for each in started.tries(first))
    if others and placement is None:
        problem = plan.problem_of(
            robot, functions=started.functions_of(started.going())
        )
        phased = plan.solve_phases(plan.PhasedProblem.of_one(name, problem), fewer=True)
        chosen = Placement(task=first.name, method="auto", phased=phased)
    elif len(chosen.phases) > 1:
        phase = next(p for p in chosen.phased.problem.phases if p.name == name)
        phased = plan.PhasedResult.of_one(name, phase.problem, chosen.phases[name])
        chosen = Placement(task=chosen.task, method=chosen.method, phased=phased)
    if not chosen.where or (not chosen.feasible and chosen.method in SOLVERS):
        what = " and ".join(f"'{each.name}'" for each in (first, *others))
        raise RobotError(f"task {what} has no placement: {chosen.reason}")
    return FirstPhase(started, chosen)
