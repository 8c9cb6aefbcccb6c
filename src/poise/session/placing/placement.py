"""Decides where the components of a task run, and says why."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from rich.console import RenderableType

from poise import plan
from poise.errors import UsageError
from poise.estimate.success import Conditions
from poise.estimate.success.learning import WELL, actions_in, learned
from poise.model.robot import Robot
from poise.plan.solvers.portfolio import METHODS as SOLVERS
from poise.session.placing.by_time import decide_by_time
from poise.session.placing.rules import RULES, by_rule, is_file, is_rule
from poise.session.render.html.picture import planned_picture
from poise.session.render.plan import plan_parts
from poise.session.render.printable import Printable
from poise.simulation.predicted_times import PredictedTimes

ALL = "all"
"""The name of the one phase in which all functions of the robot run."""
METHODS = (*SOLVERS, *RULES)
"""What may decide: a solver, or a rule that knows no objective."""


class Placement(Printable, Struct, frozen=True, kw_only=True):
    """Where each component of a task runs, and why.

    It prints itself as a table, in a terminal and in a notebook.

    Parameters
    ----------
    task
        The task; None: all functions of the robot.
    method
        What was asked to decide.
    phased
        The placements of the task's phases with the terms of F, their bounds, and what
        was put aside; or why there are none. There is one phase where all runs at once.
    predicted
        Phase -> how old the data of its chains is predicted to be; empty where the
        robot has no chains.
    """

    task: str | None
    method: str
    phased: plan.PhasedResult
    predicted: Mapping[str, PredictedTimes] = {}

    @property
    def phases(self) -> Mapping[str, plan.Result]:
        """Phase -> its result, with its `placement`; in the order of the task."""
        return self.phased.results

    @property
    def moves(self) -> tuple[plan.PhaseMove, ...]:
        """What moves between phases that follow each other."""
        return self.phased.moves

    @property
    def result(self) -> plan.Result:
        """The result of the only phase; UsageError when there are several."""
        return self.phased.only[1]

    @property
    def problem(self) -> plan.Problem:
        """What was decided about in the only phase; UsageError as for `result`."""
        return self.phased.only[0]

    @property
    def where(self) -> Mapping[str, str]:
        """Component -> computer; empty when there is no placement.

        UsageError when there are several phases.
        """
        return self.result.placement

    @property
    def architectures(self) -> Mapping[str, str]:
        """Function -> the architecture that provides it."""
        return {
            bundle.function: bundle.name
            for bundle in self.problem.architectures
            if self.where.keys() >= {*bundle.components}
        }

    @property
    def why_aside(self) -> str:
        """Why architectures are put aside; empty when all of the task runs."""
        return f"not all fits: {self.reason}" if self.result.aside else ""

    @property
    def feasible(self) -> bool:
        """Whether each phase has a placement that keeps every limit."""
        return self.phased.feasible

    @property
    def reason(self) -> str:
        """Why it is not feasible; empty when it is."""
        several = len(self.phases) > 1
        return self.phased.reason if several else self.result.reason

    def __getitem__(self, component: str) -> str:
        """Return the computer of a component; UsageError when there are phases."""
        return self.where[component]

    def explain(
        self, name: str, phase: str | None = None
    ) -> plan.Explanation | plan.Rejection:
        """Say why a component is where it is, and what each other computer costs.

        Of an architecture that was not chosen: why not, and what it costs.

        Parameters
        ----------
        phase
            Its name; None: the first in which the component or architecture may run.
        """
        return self.phased.explain(phase or self.phased.first_with(name), name)

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return plan_parts(self.phased, self.predicted)

    def picture(self) -> str:
        """Return each phase's computers with their components, as HTML."""
        several = len(self.phases) > 1
        return "".join(
            planned_picture(result, name if several else "")
            for name, result in self.phases.items()
        )


def place(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    method: str = "auto",
    budget: float | None = None,
    seed: int = 0,
    fewer: bool = False,
    conditions: Conditions = WELL,
    explore: bool = False,
    at_once: bool = False,
) -> Placement:
    """Decide where the components of a task run, and which alternatives do.

    Parameters
    ----------
    task
        Its name; None: all functions of the robot.
    method
        ``auto``, ``greedy``, ``exact`` or ``search``; ``static``: every architecture on
        its home; ``round-robin``; ``whole-functions``;
        ``random:SEED``; or a file with
        ``component: computer``.
    budget
        Time to decide [s]; None: 0.1, and 0.3 for a task of several phases.
    seed
        Of the search, and of what is drawn to explore.
    fewer
        Whether architectures of low priority are put aside when not all fits.
    conditions
        For which success was learned (`poise.note_outcome`).
    explore
        Whether alternatives are tried in proportion to what they promise; the robot
        file's `explore` does the same.
    at_once
        Whether all that the task needs runs the whole time, in spite of its order.

    Returns
    -------
    The placement. When there is none, it says why: `feasible` is then false.

    Raises
    ------
    UsageError
        There is no such task or method.
    RobotError
        A component can run nowhere, or an architecture has no home.
    """
    robot = learned(
        robot,
        actions_in(robot, task),
        conditions=conditions,
        explore=explore,
        seed=seed,
    ).robot
    if task is None or at_once:
        name = task or ALL
        problem = plan.PhasedProblem.of_one(name, plan.problem_of(robot, task))
    else:
        problem = plan.phased_problem_of(robot, task)

    def decide(asked: plan.PhasedProblem) -> plan.PhasedResult:
        return ruled(method, robot, asked) or plan.solve_phases(
            asked, budget, method, seed, fewer=fewer
        )

    decided = decide_by_time(robot, problem, decide)
    return Placement(
        task=task, method=method, phased=decided.phased, predicted=decided.predicted
    )


def ruled(
    method: str, robot: Robot | None, problem: plan.PhasedProblem
) -> plan.PhasedResult | None:
    """Return what a rule places in each phase; None: a solver is to decide.

    Parameters
    ----------
    robot
        Whose problem it is; None: nobody's.

    Raises
    ------
    UsageError
        There is no such method, the rule needs a robot, or it is a file and there are
        several phases.
    """
    if method in SOLVERS:
        return None
    if not is_rule(method):
        raise UsageError(f"no method '{method}' (there are: {', '.join(METHODS)})")
    if robot is None:
        raise UsageError(f"'{method}' needs a robot file: a plain problem has no homes")
    if is_file(method) and len(problem.phases) > 1:
        raise UsageError(
            f"placement {method}: a file places all at once, and this task has phases"
        )
    results = {
        phase.name: plan.evaluate(
            phase.problem, by_rule(method, robot, phase.problem), method
        )
        for phase in problem.phases
    }
    return plan.PhasedResult(problem, results)
