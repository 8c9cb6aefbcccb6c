"""Where the components of each phase run, and what moves between phases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

from msgspec import Struct, to_builtins

from poise.errors import UsageError, unknown
from poise.plan.explanation import Explanation, Rejection, explain
from poise.plan.phase_problem import NEVER, TaskProblem, with_moves
from poise.plan.problem.problem import Problem
from poise.plan.result import Result
from poise.plan.result_records import PlainResult, Stopped


class PhaseMove(Struct, frozen=True, kw_only=True):
    """A component that is elsewhere in a phase than in one before.

    Parameters
    ----------
    before, after
        The phases.
    source, target
        Its computers there.
    often
        How often a run of the task is expected to go from the one to the other.
    """

    component: str
    before: str
    after: str
    source: str
    target: str
    often: float


class PlainPhase(PlainResult):
    """The placement of a phase; `after` says how often it follows which one."""

    name: str
    after: Mapping[str, float]
    lasts: float
    weight: float


class PlainPhases(TypedDict):
    """What is printed of placements with phases with `--json`."""

    feasible: bool
    reason: str
    total: float | None
    proven: bool
    bound: float | None
    seconds: float
    assumed: tuple[str, ...]
    moves: tuple[PhaseMove, ...]
    phases: list[PlainPhase]


class TaskResult(Struct, eq=False):
    """A placement of each phase of a task.

    Attributes
    ----------
    problem
        What was decided about.
    results
        Phase -> its own result, in the order of the task; its F has no moves.
    proven
        Whether no placements are better; of infeasible ones: whether there are none.
    bound
        The total is not below this; None when it is not known.
    stopped_by
        Why the search stopped.
    seconds
        How long deciding took [s].
    """

    problem: TaskProblem
    results: Mapping[str, Result]
    proven: bool = False
    bound: float | None = None
    seconds: float = 0.0
    stopped_by: Stopped = "done"

    @property
    def moves(self) -> tuple[PhaseMove, ...]:
        """What moves between phases that follow each other."""
        return tuple(
            PhaseMove(
                component=name,
                before=before,
                after=phase.name,
                source=source,
                target=target,
                often=often,
            )
            for phase in self.problem.phases
            for before, often in phase.after.items()
            for name, target in self.results[phase.name].placement.items()
            if (source := self.results[before].placement.get(name, target)) != target
        )

    @property
    def total(self) -> float | None:
        """The mean of F over the time, with the moves; None when a phase has none."""
        weights = self.problem.weights
        phases = [
            weights[name] * result.objective.total
            for name, result in self.results.items()
            if result.objective is not None
        ]
        return sum(phases) + self.of_moves if len(phases) == len(weights) else None

    @property
    def of_moves(self) -> float:
        """What the moves add to the total."""
        whole = self.problem.lasts
        return sum(
            self.problem.move_cost(move.component, move.often, whole)
            for move in self.moves
        )

    @property
    def feasible(self) -> bool:
        """Whether every phase has a placement, and nothing moves that may not."""
        return all(r.feasible for r in self.results.values()) and not self._forbidden

    @property
    def reason(self) -> str:
        """Why it is not feasible, or something is suspended, by phase, for people."""
        said = [
            f"phase '{name}': {result.reason}"
            for name, result in self.results.items()
            if result.reason
        ]
        said += [
            f"'{move.component}' may not be moved while it runs, but no computer was "
            f"found that suits it in both '{move.before}' and '{move.after}'"
            for move in self._forbidden
        ]
        return "; ".join(said)

    @classmethod
    def of_one(cls, name: str, problem: Problem, result: Result) -> TaskResult:
        """Return a result of one phase."""
        return cls(TaskProblem.of_one(name, problem), {name: result})

    def first_with(self, name: str) -> str:
        """Return the first phase with a component or architecture.

        One with a placement comes before others.

        Raises
        ------
        UsageError
            No phase has it.
        """
        found = self._phases_with(name)
        return next((p for p in found if self.results[p].placement), found[0])

    def _phases_with(self, name: str) -> list[str]:
        known: dict[str, None] = {}
        found: list[str] = []
        for phase in self.problem.phases:
            names = [component.name for component in phase.problem.components]
            names += [bundle.name for bundle in phase.problem.architectures]
            known |= dict.fromkeys(names)
            if name in names:
                found.append(phase.name)
        if not found:
            raise UsageError(
                f"no component is called {name!r} (there are: {', '.join(known)})"
            )
        return found

    @property
    def only(self) -> tuple[Problem, Result]:
        """The problem and the result of the only phase.

        Raises
        ------
        UsageError
            There are several.
        """
        if len(self.results) > 1:
            raise UsageError(
                f"it has {len(self.results)} phases ({', '.join(self.results)}), each "
                "with a placement of its own: see `phases`, or place it `at_once`"
            )
        phase = self.problem.phases[0]
        return phase.problem, self.results[phase.name]

    @property
    def _forbidden(self) -> list[PhaseMove]:
        move = self.problem.move
        return [m for m in self.moves if move.get(m.component, 0.0) >= NEVER]

    def explain(self, phase: str, name: str) -> Explanation | Rejection:
        """Return why a component of a phase is where it is: moves count.

        Raises
        ------
        UsageError
            There is no such phase or component, or the phase is without it or without
            a placement.
        """
        if phase not in self.results:
            raise UsageError(unknown("phase", phase, self.results))
        if phase not in (found := self._phases_with(name)):
            what = f"{name!r} is not in phase {phase!r}; it is in: {', '.join(found)}"
            raise UsageError(what)
        if not self.results[phase].placement:
            reason = self.results[phase].reason
            raise UsageError(f"phase {phase!r} has no placement: {reason}")
        placements = {name: r.placement for name, r in self.results.items()}
        problem = with_moves(self.problem, phase, placements)
        return explain(problem, self.results[phase].placement, name)

    def to_dict(self) -> PlainPhases:
        """Return all of it as plain values, for JSON."""
        weights = self.problem.weights
        return {
            "feasible": self.feasible,
            "reason": self.reason,
            "total": self.total,
            "proven": self.proven,
            "bound": self.bound,
            "seconds": self.seconds,
            "assumed": self.problem.assumed,
            "moves": to_builtins(self.moves),
            "phases": [
                {
                    "name": phase.name,
                    "after": phase.after,
                    "lasts": phase.lasts,
                    "weight": weights[phase.name],
                    **self.results[phase.name].to_dict(),
                }
                for phase in self.problem.phases
            ],
        }
