"""The problem of placing each phase of a task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from math import inf

from msgspec import Struct
from msgspec.structs import force_setattr, replace

from poise.errors import RobotError, unknown
from poise.model.phases import assumed, phases_of
from poise.model.robot import Computer, Robot
from poise.plan.from_robot import MEGABYTE, check_task, problem_of
from poise.plan.problem.arrays import arrays_of, overhead_scale
from poise.plan.problem.problem import Problem

MOVE = 0.3
"""What a move between phases costs, and as much again for each MB of state: the CPU
time to start a component [core-seconds]. F of 1 is taken to cost one core."""
NEVER = 1e6
"""What F grows by when a component moves that may not while it runs."""


class PhaseProblem(Struct, frozen=True, kw_only=True):
    """The problem of one phase.

    Parameters
    ----------
    after
        The names of the phases that it may follow, and how often it is expected to in
        a run of the task; >= 0.
    lasts
        How long a run of the task is expected to be in it [s]; > 0.
    """

    name: str
    problem: Problem
    after: Mapping[str, float] = {}
    lasts: float = 1.0


class TaskProblem(Struct, frozen=True, kw_only=True):
    """The problems of all phases of a task, whose F has one unit.

    Phases without an `overhead_scale` get one that is the same for all.

    Parameters
    ----------
    move
        Component -> what it costs that it is elsewhere in a phase than in the one
        before [core-seconds], `NEVER` when it may not be; 0 where not named.
    assumed
        What is assumed of how long and how likely phases are, for people.
    """

    phases: tuple[PhaseProblem, ...]
    move: Mapping[str, float] = {}
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Give all phases the same overhead scale, or raise a RobotError."""
        if wrong := list(_faults(self.phases)):
            raise RobotError("the phases are wrong:\n  " + "\n  ".join(wrong))
        if len(self.phases) > 1:
            force_setattr(self, "phases", _in_one_unit(self.phases, self.lasts))

    @property
    def computers(self) -> tuple[Computer, ...]:
        """The computers, which are the same in every phase."""
        return self.phases[0].problem.computers

    @property
    def lasts(self) -> float:
        """How long a run of the task is expected to take [s]."""
        return sum(phase.lasts for phase in self.phases)

    @property
    def weights(self) -> dict[str, float]:
        """Phase -> its share of the time."""
        total = self.lasts
        return {phase.name: phase.lasts / total for phase in self.phases}

    @classmethod
    def of_one(cls, name: str, problem: Problem) -> TaskProblem:
        """Return it with one phase."""
        return cls(phases=(PhaseProblem(name=name, problem=problem),))

    def changed(self, change: Callable[[Problem], Problem]) -> TaskProblem:
        """Return it with the problem of every phase changed."""
        phases = (replace(p, problem=change(p.problem)) for p in self.phases)
        return replace(self, phases=tuple(phases))

    def move_cost(self, component: str, often: float, seconds: float) -> float:
        """Return what F over some time grows by when a component moves so often.

        Parameters
        ----------
        seconds
            F is the mean over this time [s].
        """
        move = self.move.get(component, 0.0)
        return move if move >= NEVER else move * often / seconds


def _faults(phases: tuple[PhaseProblem, ...]) -> Iterator[str]:
    """Yield everything that is wrong with phases, each with its name."""
    if not phases:
        yield "there are none; a task has one at least"
    counts = Counter(phase.name for phase in phases)
    for name, count in counts.items():
        if count > 1:
            yield f"phase {name!r} is there {count} times; names must be unique"
    for phase in phases:
        where = f"phase {phase.name!r}"
        if not 0 < phase.lasts < inf:
            yield f"{where}: lasts is {phase.lasts}, must be finite and above 0"
        for before, often in phase.after.items():
            if before not in counts:
                yield f"{where}: {unknown('phase', before, counts)}"
            if not 0 <= often < inf:
                yield f"{where}: after {before!r} is {often}, must be finite and >= 0"
        if phase.problem.computers != phases[0].problem.computers:
            yield f"{where}: its computers are not those of {phases[0].name!r}"


def _in_one_unit(
    phases: tuple[PhaseProblem, ...], lasts: float
) -> tuple[PhaseProblem, ...]:
    """Return the phases with the scale of their mean overhead over time."""
    problem = phases[0].problem
    is_given = all(p.problem.overhead_scale is not None for p in phases)
    if is_given or problem.objective.scale == "paper":
        return phases
    arrays = [(phase.lasts / lasts, arrays_of(phase.problem)) for phase in phases]
    scale = overhead_scale(
        problem,
        sum(share * arrays_.overhead for share, arrays_ in arrays),
        sum(share * arrays_.traffic for share, arrays_ in arrays),
    )
    return tuple(
        replace(p, problem=replace(p.problem, overhead_scale=scale)) for p in phases
    )


def task_problem_of(robot: Robot, task: str) -> TaskProblem:
    """Return the problems of the phases of a task.

    Raises
    ------
    RobotError
        When a function is not there, or a component can run nowhere.
    UsageError
        When there is no such task.
    """
    check_task(robot, task)
    return TaskProblem(
        phases=tuple(
            PhaseProblem(
                name=phase.name,
                problem=problem_of(robot, functions=phase.functions),
                after=phase.after,
                lasts=phase.lasts,
            )
            for phase in phases_of(robot, task)
        ),
        move={
            c.name: MOVE * (1 + c.state / MEGABYTE) if c.movable else NEVER
            for c in robot.components()
        },
        assumed=tuple(assumed(robot, task)),
    )


Placements = Mapping[str, Mapping[str, str]]
"""Phase -> component -> computer."""


def beside(problem: TaskProblem) -> dict[str, dict[str, float]]:
    """Return phase -> the phases before and after it, and how often it goes there."""
    near: dict[str, dict[str, float]] = {p.name: {} for p in problem.phases}
    for phase in problem.phases:
        for before, often in phase.after.items():
            for one, two in ((phase.name, before), (before, phase.name)):
                near[one][two] = near[one].get(two, 0.0) + often
    return near


def with_moves(
    problems: TaskProblem, phase: str, placements: Placements, *, start: bool = False
) -> Problem:
    """Return the problem of a phase, with the costs of moves to those beside it."""
    this = next(candidate for candidate in problems.phases if candidate.name == phase)
    problem = this.problem
    own = placements.get(phase, {}) if start else {}
    near = [
        (placements[name], often)
        for name, often in beside(problems)[phase].items()
        if name in placements
    ]
    function = {
        name: bundle.function
        for bundle in problem.architectures
        for name in bundle.components
    }
    of_function: dict[str, set[str]] = {}
    for bundle in problem.architectures:
        of_function.setdefault(bundle.function, set()).update(bundle.components)
    names = [computer.name for computer in problem.computers]
    components = []
    for component in problem.components:
        cost = {name: component.cost.get(name, 0.0) for name in names}
        for there, often in near:
            move = problems.move_cost(component.name, often, this.lasts)
            if component.name in there:
                for name in cost.keys() - {there[component.name]}:
                    cost[name] += move
            elif there.keys() & of_function.get(function.get(component.name, ""), ()):
                starts = MOVE * often / this.lasts
                for name in cost:
                    cost[name] += starts if move >= NEVER else move
        present = own.get(component.name, component.present)
        components.append(replace(component, cost=cost, present=present))
    return replace(problem, components=tuple(components))
