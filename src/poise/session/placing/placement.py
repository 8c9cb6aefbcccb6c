"""Decides where the components of a task run, and says why."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from itertools import cycle
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import yaml
from msgspec import Struct
from rich.console import RenderableType

from poise import plan
from poise.errors import UsageError, unknown
from poise.estimate.outcomes import WELL, Conditions
from poise.estimate.success_rates import learned, with_success
from poise.model.robot import Robot
from poise.plan.planner import SOLVERS
from poise.plan.problem.problem import needs
from poise.session.arguments import check_robot, check_task, check_type
from poise.session.placing.by_time import DecidedByTime, Solve, decide_by_time
from poise.session.render.picture import planned_picture
from poise.session.render.plan_tables import plan_parts
from poise.session.render.printable import Printable
from poise.simulation.predicted_times import PredictedTimes

RULES = ("static", "round-robin", "whole-functions", "random:SEED", "FILE")
"""What may place instead of a solver. `FILE` (.yaml or .json) has
``component: computer``, or is what ``poise plan --json`` printed. An architecture is
suspended where the file says so, or has its components on null."""


def is_rule(name: str) -> bool:
    """Return whether a name is one of `RULES`."""
    return name in RULES[:3] or name.startswith("random:") or is_file(name)


def is_file(name: str) -> bool:
    """Return whether a rule is a file with a placement."""
    return Path(name).suffix in {".yaml", ".yml", ".json"}


def by_rule(rule: str, robot: Robot, problem: plan.Problem) -> dict[str, str]:
    """Return component -> computer, where it may run, as a rule that is no file has it.

    It may break limits. ``whole-functions`` keeps what belongs to a function on one
    computer, the largest function first, where most CPU is left.
    """
    static = plan.static(robot, problem)
    choices = _choices(problem)
    if rule == "static":
        return static
    if rule == "round-robin":
        turns = {each: cycle(each) for each in choices.values()}
        return {name: next(turns[choices[name]]) for name in static}
    if rule == "whole-functions":
        return _whole(problem, static, choices)
    chance = random.Random(_seed(rule))  # noqa: S311 - nothing secret
    return {name: chance.choice(choices[name]) for name in static}


def _choices(problem: plan.Problem) -> dict[str, tuple[str, ...]]:
    """Return component -> the computers where it may run."""
    names = [computer.name for computer in problem.computers]
    return {each.name: tuple(each.only or names) for each in problem.components}


def _whole(
    problem: plan.Problem,
    wanted: Collection[str],
    choices: Mapping[str, tuple[str, ...]],
) -> dict[str, str]:
    """Return where functions go, as a person would deal them out."""
    cpu = {each.name: each.demand.get("cpu", 0.0) for each in problem.components}
    left = {c.name: c.capacity.get("cpu", 0.0) * c.speed for c in problem.computers}
    functions = [
        [name for name in bundle.components if name in wanted]
        for bundle in problem.architectures
    ]
    placement = {}
    for function in sorted(functions, key=lambda f: -sum(cpu[name] for name in f)):
        best = max(left, key=lambda computer: left[computer])
        for name in function:
            here = choices[name]
            placement[name] = best if best in here else here[0]
            left[placement[name]] -= cpu[name]
    return placement


def _seed(rule: str) -> int:
    try:
        return int(rule.removeprefix("random:"))
    except ValueError:
        raise UsageError(
            f"placement '{rule}': the seed is a whole number, as in random:7"
        ) from None


class _NamesLoader(yaml.SafeLoader):
    """Reads null and texts: for PyYAML, the names `on` and `no` are truth values."""

    yaml_implicit_resolvers = {  # noqa: RUF012, PyYAML's
        first: [each for each in known if each[0] == "tag:yaml.org,2002:null"]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:  # noqa: ANN401, FBT001, FBT002, as PyYAML has it
        """Return a mapping; of equal names PyYAML would take the last."""
        for name, count in Counter(str(key.value) for key, _ in node.value).items():
            if count > 1:
                raise ValueError(f"'{name}' is there {count} times")
        return super().construct_mapping(node, deep)


def _read(path: Path) -> tuple[Mapping[object, object], frozenset[str]]:
    """Return what a file places, and the architectures that it calls suspended."""
    try:
        text = path.read_text(encoding="utf-8")
        found = yaml.load(text, _NamesLoader)  # noqa: S506, it is safe
    except (OSError, ValueError, yaml.YAMLError) as error:
        # PyYAML raises ValueError for some tagged values, such as !!int x
        why = getattr(error, "strerror", "") or error
        raise UsageError(f"placement {path} cannot be read: {why}") from error
    suspended: object = None
    if isinstance(found, dict) and isinstance(found.get("placement"), dict):
        suspended, found = found.get("suspended"), found["placement"]
    if not isinstance(found, dict):
        raise UsageError(
            f"placement {path} is not a mapping of components to computers"
        )
    if not isinstance(suspended, list | None):
        raise UsageError(f"placement {path}: 'suspended' is no list of architectures")
    return found, frozenset(map(str, suspended or ()))


def _checked(
    rule: str, found: Mapping[object, object], choices: Mapping[str, tuple[str, ...]]
) -> dict[str, str]:
    """Return the placement in a file; UsageError with all that is wrong with it."""
    faults = []
    placement = {}
    for component, computer in found.items():
        name, where = str(component), str(computer)
        if name not in choices:
            faults.append(f"the task needs no component '{name}'")
        elif computer is None:
            continue
        elif where not in choices[name]:
            here = " or ".join(choices[name])
            faults.append(f"'{name}' may not run on '{where}', only on {here}")
        placement[name] = where
    if faults:
        raise UsageError(f"placement {rule}: {'; '.join(faults)}")
    return placement


def _by_file(rule: str, robot: Robot, problem: plan.Problem) -> plan.Result:
    """Return what a file places, without what it suspends."""
    found, named = _read(Path(rule))
    placement = _checked(rule, found, _choices(problem))
    architectures = [architecture.name for architecture in robot.architectures]
    for name in sorted(named.difference(architectures)):
        said = unknown("architecture", name, architectures)
        raise UsageError(f"placement {rule} suspends what is not there: {said}")
    idle = {str(name) for name, computer in found.items() if computer is None}
    suspended, lacking = list[str](), list[str]()
    for need in needs(problem):
        names = {name for bundle in need for name in bundle.components}
        if not names & placement.keys() and _may_rest(need, idle, named):
            suspended.append(need[0].name)
        elif len(need) == 1:
            lacking += [n for n in need[0].components if n not in placement]
    if lacking:
        raise UsageError(
            f"placement {rule} lacks {', '.join(lacking)}: suspended components are "
            "on null, with their whole architecture, which only a task may have"
        )
    why = f"placement {rule} suspends {', '.join(suspended)}"
    return plan.evaluate(problem, placement, rule, suspended=tuple(suspended), why=why)


def _may_rest(
    need: Sequence[plan.Bundle], idle: AbstractSet[str], named: AbstractSet[str]
) -> bool:
    """Return whether a function is suspended: on null, or named, and not required."""
    return not any(bundle.required for bundle in need) and any(
        bundle.name in named or (bundle.components and idle >= {*bundle.components})
        for bundle in need
    )


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
    task_result
        The placements of the task's phases with the terms of F, their bounds, and what
        was suspended; or why there are none. There is one phase where all runs at once.
    predicted
        Phase -> how old the data of its chains is predicted to be, and when its timers
        end; empty where there are no deadlines.
    """

    task: str | None
    method: str
    task_result: plan.TaskResult
    predicted: Mapping[str, PredictedTimes] = {}

    @property
    def phases(self) -> Mapping[str, plan.Result]:
        """Phase -> its result, with its `placement`; in the order of the task."""
        return self.task_result.results

    @property
    def moves(self) -> tuple[plan.PhaseMove, ...]:
        """What moves between phases that follow each other."""
        return self.task_result.moves

    @property
    def result(self) -> plan.Result:
        """The result of the only phase; UsageError when there are several."""
        return self.task_result.only[1]

    @property
    def problem(self) -> plan.Problem:
        """What was decided about in the only phase; UsageError as for `result`."""
        return self.task_result.only[0]

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
    def why_suspended(self) -> str:
        """Why architectures are suspended; empty when all of the task runs."""
        return f"not all fits: {self.reason}" if self.result.suspended else ""

    @property
    def feasible(self) -> bool:
        """Whether each phase has a placement that keeps every limit."""
        return self.task_result.feasible

    @property
    def reason(self) -> str:
        """Why it is not feasible; empty when it is."""
        several = len(self.phases) > 1
        return self.task_result.reason if several else self.result.reason

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
        return self.task_result.explain(
            phase or self.task_result.first_with(name), name
        )

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return plan_parts(self.task_result, self.predicted)

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
        Time to decide [s]; None: 0.1, and 0.26 for a task of several phases.
    seed
        Of the search, and of what is drawn to explore.
    fewer
        Whether architectures of low priority are suspended when not all fits.
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
    check_robot(robot)
    check_task(task)
    check_type("method", method, str, "the name of a method, such as auto")
    check_type("seed", seed, Integral, "a whole number")
    check_type("budget", budget, Real | None, "a number of seconds")
    actions = tuple(robot.actions(task))
    robot = learned(
        robot, actions, conditions=conditions, explore=explore, seed=seed
    ).robot
    robot = with_success(robot, actions, conditions)
    problem = problem_of_task(robot, task, at_once=at_once)
    solve = partial(
        plan.solve_phases, budget=budget, method=method, seed=seed, fewer=fewer
    )
    found = decided(robot, problem, method, solve)
    result, predicted = found.task_result, found.predicted
    return Placement(task=task, method=method, task_result=result, predicted=predicted)


def problem_of_task(
    robot: Robot, task: str | None, *, at_once: bool = False
) -> plan.TaskProblem:
    """Return what is to be decided for a task; None: for all functions, at once."""
    if task is None or at_once:
        return plan.TaskProblem.of_one(task or ALL, plan.problem_of(robot, task))
    return plan.task_problem_of(robot, task)


def decided(
    robot: Robot | None,
    problem: plan.TaskProblem,
    method: str,
    solve: Solve,
    check: Callable[[], None] | None = None,
) -> DecidedByTime:
    """Return what a rule decides, or else a solver; None: there is no robot file."""

    def decide(asked: plan.TaskProblem) -> plan.TaskResult:
        return _ruled(method, robot, asked) or solve(asked)

    if robot is None:
        return DecidedByTime(decide(problem))
    is_searched = method != "greedy" and not is_rule(method)
    others = (partial(solve, method="greedy"),) if is_searched else ()
    return decide_by_time(robot, problem, decide, *others, check=check)


def _ruled(
    method: str, robot: Robot | None, problem: plan.TaskProblem
) -> plan.TaskResult | None:
    """Return what a rule places in each phase; None: a solver is to decide."""
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
    if is_file(method):
        (phase,) = problem.phases
        result = _by_file(method, robot, phase.problem)
        return plan.TaskResult(problem, {phase.name: result})
    results = {}
    for phase in problem.phases:
        where = by_rule(method, robot, phase.problem)
        results[phase.name] = plan.evaluate(phase.problem, where, method)
    return plan.TaskResult(problem, results)
