"""What runs first when tasks are started together, and where."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.clock import boot_time
from poise.errors import RobotError, UsageError
from poise.estimate.code_version import hash_of
from poise.estimate.outcomes import WELL
from poise.manage.journal import Journal
from poise.manage.tasks.component_reports import choose
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.model.robot import Robot
from poise.plan.planner import SOLVERS
from poise.session import Say
from poise.session.placing.placement import Placement, decided, place


class FirstPhase(Struct, frozen=True):
    """Tasks that are started, and the placement of what their first actions need."""

    tasks: Tasks
    placed: Placement


def first_phase(
    robot: Robot, tasks: Sequence[str], placement: Placement | None, say: Say
) -> FirstPhase:
    """Start tasks, and place what their first actions need, as far as it fits."""
    _check_placement(placement, tasks)
    started = Tasks(robot, say, lambda c, _: choose(robot, c, WELL, say))
    now = boot_time()
    for name in tasks:
        started.start(name, now)
    started.arbitrate(now)
    started.announce()
    first, *others = started.going()
    chosen = placement or place(robot, first.name, fewer=True)
    if chosen.task_result.reason and len(chosen.phases) > 1:
        say(f"not all of task '{first.name}' fits: {chosen.task_result.reason}")
    name = "+".join(each.name for each in started.tries(first))
    if others and placement is None:
        problem = plan.problem_of(
            robot, functions=started.functions_of(started.going())
        )
        whole = plan.TaskProblem.of_one(name, problem)
        found = decided(robot, whole, "auto", partial(plan.solve_phases, fewer=True))
        chosen = replace(
            chosen, task_result=found.task_result, predicted=found.predicted
        )
    elif len(chosen.phases) > 1:
        phase = next(p for p in chosen.task_result.problem.phases if p.name == name)
        task_result = plan.TaskResult.of_one(name, phase.problem, chosen.phases[name])
        predicted = {n: t for n, t in chosen.predicted.items() if n == name}
        chosen = replace(chosen, task_result=task_result, predicted=predicted)
    if not chosen.where or (not chosen.feasible and chosen.method in SOLVERS):
        what = " and ".join(f"'{each.name}'" for each in (first, *others))
        raise RobotError(f"task {what} has no placement: {chosen.reason}")
    return FirstPhase(started, chosen)


def _check_placement(placement: object, tasks: Sequence[str]) -> None:
    """Raise UsageError for what is no placement, or is one of another task."""
    if placement is None:
        return
    if not isinstance(placement, Placement):
        raise UsageError(
            f"{placement!r} is not a placement: `poise.place(robot, TASK, method=...)` "
            "returns one"
        )
    if placement.task is not None and [*tasks] != [placement.task]:
        wanted = " and ".join(f"'{each}'" for each in tasks)
        raise UsageError(
            f"the placement is of task '{placement.task}', not of {wanted}: "
            "`poise.place(robot, TASK)` returns one, and without TASK that of all"
        )


def note_architectures(journal: Journal, robot: Robot, placement: Placement) -> None:
    """Write into the journal which architectures there are, and which of them run."""
    runs = set(placement.architectures.values())
    facts = {
        a.name: {
            "function": a.function,
            "hash": hash_of(a, robot.folders),
            "file": a.file,
            "package": a.package,
            "runs": a.name in runs,
        }
        for a in robot.architectures
    }
    served = [
        f"{fact['function']} by '{name}' ({fact['hash']}"
        + (f", {fact['package'] or fact['file']})" if fact["file"] else ")")
        for name, fact in facts.items()
        if fact["runs"]
    ]
    journal.note("decided", f"provided: {'; '.join(served)}", architectures=facts)
