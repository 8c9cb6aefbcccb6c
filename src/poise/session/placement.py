"""Decides where the components of a task run, and says why."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from rich.console import RenderableType

from poise import plan
from poise.errors import RobotError, UsageError
from poise.estimate.success import Situation
from poise.estimate.success.learning import WELL, actions_in, learned
from poise.model.robot import Robot
from poise.model.tasks.phases import phases_of
from poise.plan.solvers.portfolio import METHODS as SOLVERS
from poise.session.placement_rules import RULES, by_rule, is_rule
from poise.session.render.plan import plan_parts
from poise.session.render.shown import Shown

METHODS = (*SOLVERS, *RULES)
"""What may decide: a solver, or a rule that knows no objective."""


class Placement(Shown, Struct, frozen=True, kw_only=True):
    """Where each component of a task runs, and why.

    It prints itself as a table, in a terminal and in a notebook.

    Parameters
    ----------
    task
        The task; None: all functions of the robot.
    method
        What was asked to decide.
    problem
        What was decided about.
    result
        The placement with the terms of F, its bound, and what was put aside; or why
        there is none.
    """

    task: str | None
    method: str
    problem: plan.Problem
    result: plan.Result

    @property
    def where(self) -> Mapping[str, str]:
        """Component -> computer; empty when there is no placement."""
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
        """Whether there is a placement that keeps every limit."""
        return self.result.feasible

    @property
    def reason(self) -> str:
        """Why it is not feasible; empty when it is."""
        return self.result.reason

    def __getitem__(self, component: str) -> str:
        """Return the computer of a component."""
        return self.where[component]

    def explain(self, name: str) -> plan.Explanation | plan.Rejection:
        """Say why a component is where it is, and what each other computer costs.

        Of an architecture that was not chosen: why not, and what it costs.
        """
        return plan.explain(self.problem, self.where, name)

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return plan_parts(self.result)


def place(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    method: str = "auto",
    budget: float = 0.1,
    seed: int = 0,
    fewer: bool = False,
    situation: Situation = WELL,
    explore: bool = False,
) -> Placement:
    """Decide where the components of a task run, and which alternatives do.

    Parameters
    ----------
    task
        Its name; None: all functions of the robot.
    method
        ``auto``, ``greedy``, ``exact``, ``search`` or ``cpsat``; ``static``: every
        architecture on its home; ``round-robin``; ``random:SEED``; or a file with
        ``component: computer``.
    budget
        Time to decide [s].
    seed
        Of the search, and of what is drawn to explore.
    fewer
        Whether architectures of low priority are put aside when not all fits.
    situation
        For which success was learned (`poise.note_outcome`).
    explore
        Whether alternatives are tried in proportion to what they promise; the robot
        file's `explore` does the same.

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
        robot, actions_in(robot, task), situation=situation, explore=explore, seed=seed
    ).robot
    problem = plan.problem_of(robot, task)
    result = ruled(method, robot, problem)
    if result is None:
        result = plan.solve(problem, budget, method, seed, fewer=fewer)
    return Placement(task=task, method=method, problem=problem, result=result)


def ruled(
    method: str, robot: Robot | None, problem: plan.Problem
) -> plan.Result | None:
    """Return what a rule places; None: a solver is to decide.

    Parameters
    ----------
    robot
        Whose problem it is; None: nobody's.

    Raises
    ------
    UsageError
        There is no such method, or the rule needs a robot.
    """
    if method in SOLVERS:
        return None
    if not is_rule(method):
        raise UsageError(f"no method '{method}' (there are: {', '.join(METHODS)})")
    if robot is None:
        raise UsageError(f"'{method}' needs a robot file: a plain problem has no homes")
    return plan.evaluate(problem, by_rule(method, robot, problem), method)


def order_unused(robot: Robot, task: str) -> str:
    """Return the sentence that a task does not run in its order; empty: it has none."""
    count = len(phases_of(robot, task))
    if count < 2:  # noqa: PLR2004
        return ""
    return (
        f"task '{task}' has {count} phases, which are not run in order yet: all that "
        "they need runs at once, the whole time"
    )


def runnable(robot: Robot, task: str, placement: Placement | None) -> Placement:
    """Return the placement of a task, decided here when none is given.

    Architectures of low priority are put aside when not all fits.

    Raises
    ------
    RobotError
        There is no placement; the message says why.
    """
    chosen = place(robot, task, fewer=True) if placement is None else placement
    if not chosen.where or (not chosen.feasible and chosen.method in SOLVERS):
        raise RobotError(f"task '{task}' has no placement: {chosen.reason}")
    return chosen
