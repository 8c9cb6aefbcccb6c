"""`poise plan` of tasks with phases: how they are decided, shown and explained."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rich.console import Console

from poise import plan
from poise.cli.options import print_json
from poise.errors import UsageError
from poise.session.render.plan import (
    show_explanation,
    show_phases,
    show_rejection,
    show_smallest,
)

SolvePhases = Callable[[plan.PhasedProblem], plan.PhasedResult]


def plan_phases(
    problems: Mapping[str, plan.PhasedProblem],
    solve: SolvePhases,
    explain: str | None,
    phase: str | None,
    *,
    smallest: bool,
    json: bool,
) -> bool:
    """Decide and print the phases of tasks; return whether they are feasible.

    Parameters
    ----------
    problems
        Task -> its problem; several for `smallest` only.
    explain, phase
        What is to be explained, and in which phase; None: nothing, the first one.
    smallest
        Whether to find the cheapest computers.
    """
    if smallest and explain is not None:
        raise UsageError(
            f"--explain {explain} and --smallest: find the computers first, then ask "
            "with --without"
        )
    if smallest:
        return _answer_smallest(problems, solve, json=json)
    (problem,) = problems.values()
    result = solve(problem)
    _answer(result, explain, phase, json=json)
    return result.feasible


def _answer(
    result: plan.PhasedResult,
    explain: str | None,
    phase: str | None,
    *,
    json: bool,
) -> None:
    """Print a result, or why something is where it is in a phase."""
    explanation = None
    if explain is not None:
        phase = phase or result.first_with(explain)
        explanation = result.explain(phase, explain)
    if json:
        extra = {"phase": phase, "explanation": explanation} if explanation else {}
        print_json({**result.to_dict(), **extra})
        return
    console = Console()
    if explanation is None:
        show_phases(result, console)
        return
    console.print(f"phase {phase}:", highlight=False)
    if isinstance(explanation, plan.Rejection):
        show_rejection(explanation, console)
    else:
        show_explanation(explanation, console)


def _answer_smallest(
    tasks: Mapping[str, plan.PhasedProblem],
    solve: SolvePhases,
    *,
    json: bool,
) -> bool:
    """Print the cheapest computers on which each task fits; return whether all do."""
    problems = [*tasks.values()]
    few = plan.smallest(problems, solve)
    known = problems[0].phases[0].problem.computers
    price = sum(h.price for h in known if h.name in few.computers)
    if json:
        answer: dict[str, Any] = {
            "feasible": few.feasible,
            "computers": few.computers,
            "price": price,
            "smallest_proven": few.proven,
            "tasks": {
                task: result.to_dict()
                for task, result in zip(tasks, few.results, strict=False)
            },
        }
        print_json(answer)
        return few.feasible
    console = Console()
    if few.feasible:
        show_smallest(few, price, console)
    for task, result in zip(tasks, few.results, strict=False):
        console.print(f"\n[bold]{task}[/]", highlight=False)
        show_phases(result, console)
    return few.feasible
