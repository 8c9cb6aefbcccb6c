"""The problem of placing each phase of a task."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from poise.model.robot import Computer, Robot
from poise.model.tasks.phases import phases_of
from poise.plan.problem.from_robot import MEGABYTE, check_task, problem_of
from poise.plan.problem.problem import Problem

MOVE = 0.01
"""What F grows by for a component that moves between phases, and for each MB of its
state."""
NEVER = 1e6
"""The same for one that may not be moved while it runs."""


class PhaseProblem(Struct, frozen=True, kw_only=True):
    """The problem of one phase; `after` names the phases that it may follow."""

    name: str
    problem: Problem
    after: tuple[str, ...] = ()


class PhasedProblem(Struct, frozen=True, kw_only=True):
    """The problems of all phases of a task.

    Parameters
    ----------
    move
        Component -> what F grows by when it is elsewhere in a phase than in one that
        this may follow; 0 where not named.
    """

    phases: tuple[PhaseProblem, ...]
    move: Mapping[str, float] = {}

    @property
    def computers(self) -> tuple[Computer, ...]:
        """The computers, which are the same in every phase."""
        return self.phases[0].problem.computers

    @classmethod
    def of_one(cls, name: str, problem: Problem) -> PhasedProblem:
        """Return it with one phase."""
        return cls(phases=(PhaseProblem(name=name, problem=problem),))

    def changed(self, change: Callable[[Problem], Problem]) -> PhasedProblem:
        """Return it with the problem of every phase changed."""
        phases = (replace(p, problem=change(p.problem)) for p in self.phases)
        return replace(self, phases=tuple(phases))


def phased_problem_of(robot: Robot, task: str, move: float = MOVE) -> PhasedProblem:
    """Return the problems of the phases of a task.

    Parameters
    ----------
    move
        What F grows by for a component that moves between two phases, plus as much
        for each MB of its state.

    Raises
    ------
    RobotError
        When a function is not there, or a component can run nowhere.
    UsageError
        When there is no such task.
    """
    check_task(robot, task)
    return PhasedProblem(
        phases=tuple(
            PhaseProblem(
                name=phase.name,
                problem=problem_of(robot, functions=phase.functions),
                after=phase.after,
            )
            for phase in phases_of(robot, task)
        ),
        move={
            c.name: move * (1 + c.state / MEGABYTE) if c.movable else NEVER
            for c in robot.components()
        },
    )
