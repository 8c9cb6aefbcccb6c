"""`poise plan`: decide where each component runs, say why, and ask what if."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console

from poise import plan
from poise.cli.command.design_time.phases import plan_phases
from poise.cli.command.design_time.what_if import changed_problem
from poise.cli.completion import in_file
from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, busy, print_json
from poise.errors import UsageError
from poise.estimate.success import Situation
from poise.estimate.success.learning import actions_in, learned
from poise.model import load
from poise.model.robot import Robot
from poise.plan.phases.solve import BUDGET as PHASES_BUDGET
from poise.plan.planner import BUDGET
from poise.session.placing.placement import has_order, ruled, ruled_phases
from poise.session.profiles import profiled
from poise.session.render.plan import (
    show,
    show_comparison,
    show_explanation,
    show_rejection,
    show_smallest,
)


def plan_command(
    file: Annotated[
        Path,
        typer.Argument(help="Robot file, or problem in .json.", envvar="POISE_ROBOT"),
    ],
    task: Annotated[
        list[str] | None,
        typer.Option(
            help="Task to place; else all functions. Several: --smallest.",
            autocompletion=in_file("tasks"),
        ),
    ] = None,
    at_once: Annotated[
        bool,
        typer.Option("--at-once", help="All of the task at once."),
    ] = False,
    method: Annotated[
        str,
        typer.Option(
            help="auto, greedy, exact, search; static, round-robin, "
            "whole-functions, random:SEED or a file with `component: computer`."
        ),
    ] = "auto",
    budget: Annotated[
        float | None,
        typer.Option(help="Time to decide, in seconds: 0.1, or 0.26 for phases."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    steps: Annotated[
        int | None, typer.Option(help="Steps instead of time: reproducible.")
    ] = None,
    fewer: Annotated[
        bool,
        typer.Option("--fewer", help="Put aside what does not fit, by priority."),
    ] = False,
    explain: Annotated[
        str | None,
        typer.Option(
            help="Why is this component there, or this architecture not?",
            autocompletion=in_file("components"),
        ),
    ] = None,
    phase: Annotated[
        str | None, typer.Option(help="The phase that --explain is about.")
    ] = None,
    compare: Annotated[
        str | None, typer.Option(help="Methods side by side: static,greedy,search.")
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            help="What if this computer were gone?",
            autocompletion=in_file("computers"),
        ),
    ] = None,
    add: Annotated[
        list[str] | None, typer.Option(help="What if: NAME:cpu=2,memory=4GiB")
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(help="What if: RESOURCE=0.5 or COMPUTER=2 (x capacity)"),
    ] = None,
    smallest: Annotated[
        bool,
        typer.Option("--smallest", help="The cheapest computers for tasks; else all."),
    ] = False,
    explore: Annotated[
        bool,
        typer.Option("--explore", help="Try alternatives by what they promise."),
    ] = False,
    json: AsJson = False,
) -> None:
    """Decide where each component runs, say why, and ask what if.

    Examples
    --------
    poise plan robot.yaml --task fetch

    poise plan robot.yaml --task fetch --explain mapper --phase drive

    poise plan robot.yaml --smallest --task fetch --task greet

    poise plan robot.yaml --compare static,greedy,auto

    poise plan robot.yaml --without main --add new:cpu=4,memory=8GiB
    """
    tasks = task or []
    _check_together(tasks, explain, phase, compare, smallest=smallest, at_once=at_once)
    say = Console(stderr=True, highlight=False).print
    robot = _robot(file, tasks, say, explore=explore)

    def known(task: str | None) -> Robot | None:
        """Return the robot with what was learned of alternatives for a task."""
        if robot is None:
            return None
        situation = Situation(lost=tuple(without or ()))
        actions = actions_in(robot, task)
        found = learned(robot, actions, situation=situation, explore=explore, seed=seed)
        for sentence in found.says:
            say(sentence)
        return found.robot

    def changed(problem: plan.Problem) -> plan.Problem:
        return changed_problem(problem, without or [], add or [], scale or [])

    if smallest and robot is not None and not tasks:
        tasks = [each.name for each in robot.tasks]
    is_phased = robot is not None and not at_once and _has_phases(robot, tasks)
    _check_phased(tasks, phase, compare, is_phased=is_phased)
    with Interrupts() as interrupts:
        how = How(
            robot, method, budget, seed, steps, fewer, interrupts.has_come, not smallest
        )
        if is_phased:
            robots = {name: known(name) for name in tasks}
            problems = {
                name: plan.phased_problem_of(each, name).changed(changed)
                for name, each in robots.items()
                if each is not None
            }
            feasible = plan_phases(
                problems,
                how.solve_phases,
                explain,
                phase,
                smallest=smallest,
                json=json,
            )
        else:
            name = tasks[0] if tasks else None
            each = known(name)
            problem = plan.problem_of(each, name) if each else plan.load(file)
            feasible = _plan_one(
                changed(problem), how, explain, compare, smallest=smallest, json=json
            )
    if not feasible:
        raise typer.Exit(1)


class How(NamedTuple):
    """How to decide: the options of the command."""

    robot: Robot | None
    method: str
    budget: float | None
    seed: int
    steps: int | None
    fewer: bool
    stop: Callable[[], bool]
    why: bool

    def solve(self, problem: plan.Problem, method: str | None = None) -> plan.Result:
        """Place what runs at once."""
        method = method or self.method
        with busy("placing"):
            return ruled(method, self.robot, problem) or plan.solve(
                problem,
                BUDGET if self.budget is None else self.budget,
                method,
                self.seed,
                steps=self.steps,
                fewer=self.fewer,
                stop=self.stop,
                why=self.why,
            )

    def solve_phases(self, problem: plan.PhasedProblem) -> plan.PhasedResult:
        """Place the phases of a task."""
        with busy("placing"):
            return ruled_phases(self.method, self.robot, problem) or plan.solve_phases(
                problem,
                PHASES_BUDGET if self.budget is None else self.budget,
                self.method,
                self.seed,
                steps=self.steps,
                fewer=self.fewer,
                stop=self.stop,
                why=self.why,
            )


def _check_together(
    tasks: list[str],
    explain: str | None,
    phase: str | None,
    compare: str | None,
    *,
    smallest: bool,
    at_once: bool,
) -> None:
    """Raise UsageError for options that exclude each other."""
    other = f"--explain {explain}" if explain is not None else "--smallest"
    if compare is not None and (explain is not None or smallest):
        raise UsageError(
            f"--compare and {other} together: {other} is about one method's placement; "
            "take it with --method"
        )
    if len(tasks) > 1 and not smallest:
        raise UsageError(f"--task {' --task '.join(tasks)}: several need --smallest")
    if len(tasks) > 1 and explain is not None:
        raise UsageError(f"{other}: about one task only, not {' and '.join(tasks)}")
    if phase is not None and explain is None:
        raise UsageError(f"--phase {phase}: it goes with --explain")
    if at_once and len(tasks) != 1:
        raise UsageError("--at-once: it is about one --task")


def _check_phased(
    tasks: list[str], phase: str | None, compare: str | None, *, is_phased: bool
) -> None:
    """Raise UsageError for options that phases do not have, or only phases have."""
    if is_phased and compare is not None:
        raise UsageError(f"--compare: task '{tasks[0]}' has phases; take --at-once")
    if phase is not None and not is_phased:
        raise UsageError(f"--phase {phase}: there are no phases, all is at once")


def _has_phases(robot: Robot, tasks: list[str]) -> bool:
    """Return whether it takes phases to answer: for several tasks, or one with some."""
    return len(tasks) > 1 or any(has_order(robot, task) for task in tasks)


def _robot(
    file: Path, tasks: list[str], say: Callable[[str], None], *, explore: bool
) -> Robot | None:
    """Return the robot in `file`; None when it is a plain problem.

    Parameters
    ----------
    say
        Told where a robot's demands are from.
    explore
        Whether alternatives are to be tried: those of a robot.
    """
    if file.suffix != ".json":
        found = profiled(load(file))
        for sentence in found.says:
            say(sentence)
        return found.robot
    if explore:
        raise UsageError(f"--explore: {file} is a plain problem: nothing is learned")
    if tasks:
        raise UsageError(
            f"--task {tasks[0]}: {file} is a plain problem and has no tasks"
        )
    return None


def _plan_one(
    problem: plan.Problem,
    how: How,
    explain: str | None,
    compare: str | None,
    *,
    smallest: bool,
    json: bool,
) -> bool:
    """Decide and print what runs at once; return whether it is feasible."""
    if compare is not None:
        names = [name.strip() for name in compare.split(",")]
        results = {name: how.solve(problem, name) for name in names}
        _answer_comparison(problem, results, json=json)
        return any(result.feasible for result in results.values())
    few = plan.smallest([problem], how.solve) if smallest else None
    result = few.results[0] if few else how.solve(problem)
    _answer(_on_computers(problem, few), result, few, explain, json=json)
    return result.feasible


def _on_computers(
    problem: plan.Problem, few: plan.Smallest[plan.Result] | None
) -> plan.Problem:
    """Return the problem on the computers that were chosen."""
    kept = few.computers if few else ()
    dropped = [h.name for h in problem.computers if kept and h.name not in kept]
    return plan.without(problem, dropped) if dropped else problem


def _answer(
    problem: plan.Problem,
    result: plan.Result,
    few: plan.Smallest[plan.Result] | None,
    explain: str | None,
    *,
    json: bool,
) -> None:
    extra: dict[str, Any] = {}
    if few:
        extra |= {"computers": few.computers, "smallest_proven": few.proven}
    explanation = None
    if explain is not None and result.placement:
        explanation = plan.explain(problem, result.placement, explain)
        extra["explanation"] = explanation
    if json:
        print_json({**result.to_dict(), **extra})
        return
    console = Console()
    if few and result.feasible:
        price = sum(h.price for h in problem.computers)
        show_smallest(few, price, console)
    if isinstance(explanation, plan.Rejection):
        show_rejection(explanation, console)
    elif explanation is not None:
        show_explanation(explanation, console)
    else:
        show(result, console)


def _answer_comparison(
    problem: plan.Problem, results: dict[str, plan.Result], *, json: bool
) -> None:
    if json:
        print_json({"results": {name: r.to_dict() for name, r in results.items()}})
    else:
        show_comparison(problem, results, Console())
