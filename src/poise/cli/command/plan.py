"""`poise plan`: decide where each component runs, say why, and ask what if."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from poise import plan, units
from poise.cli.interrupts import Interrupts
from poise.cli.options import AsJson, print_json
from poise.errors import UsageError
from poise.estimate.success import Situation
from poise.estimate.success.learning import actions_in, learned
from poise.model import load
from poise.model.robot import Computer, Robot
from poise.session.placement import ruled
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
    task: Annotated[str | None, typer.Option(help="Task to place; else all.")] = None,
    method: Annotated[
        str,
        typer.Option(
            help="auto, greedy, exact, search, cpsat; static, round-robin, random:SEED "
            "or a file with `component: computer`."
        ),
    ] = "auto",
    budget: Annotated[float, typer.Option(help="Time to decide, in seconds.")] = 0.1,
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
        typer.Option(help="Why is this component there, or this architecture not?"),
    ] = None,
    compare: Annotated[
        str | None, typer.Option(help="Methods side by side: static,greedy,search.")
    ] = None,
    without: Annotated[
        list[str] | None, typer.Option(help="What if this computer were gone?")
    ] = None,
    add: Annotated[
        list[str] | None, typer.Option(help="What if: NAME:cpu=2,memory=4GiB")
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(help="What if: RESOURCE=0.5 or COMPUTER=2 (x capacity)"),
    ] = None,
    smallest: Annotated[
        bool, typer.Option("--smallest", help="The cheapest computers that do.")
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

    poise plan robot.yaml --explain mapper

    poise plan robot.yaml --compare static,greedy,auto

    poise plan robot.yaml --without main --add new:cpu=4,memory=8GiB
    """
    if compare is not None and (explain is not None or smallest):
        other = f"--explain {explain}" if explain is not None else "--smallest"
        raise UsageError(
            f"--compare and {other} together: {other} is about one method's placement; "
            "take it with --method"
        )
    notes = Console(stderr=True, highlight=False)
    robot, problem = read(
        file, task, notes.print, lost=without or (), explore=explore, seed=seed
    )
    problem = _changed(problem, without or [], add or [], scale or [])

    def solved(name: str) -> plan.Result:
        return ruled(name, robot, problem) or solve(problem, name, why=True)

    def solve(
        problem: plan.Problem, name: str = method, *, why: bool = False
    ) -> plan.Result:
        return plan.solve(
            problem,
            budget,
            name,
            seed,
            steps=steps,
            fewer=fewer,
            stop=interrupts.has_come,
            why=why,
        )

    with Interrupts() as interrupts:
        if compare is not None:
            names = [name.strip() for name in compare.split(",")]
            results = {name: solved(name) for name in names}
            _answer_comparison(problem, results, json=json)
            feasible = any(result.feasible for result in results.values())
        else:
            few = plan.smallest(problem, solve) if smallest else None
            result = few.result if few else solved(method)
            _answer(_on_computers(problem, few), result, few, explain, json=json)
            feasible = result.feasible
    if not feasible:
        raise typer.Exit(1)


def read(
    file: Path,
    task: str | None,
    say: Callable[[str], None],
    *,
    lost: Sequence[str] = (),
    explore: bool = False,
    seed: int = 0,
) -> tuple[Robot | None, plan.Problem]:
    """Return the problem in `file`, and the robot when it describes one.

    Parameters
    ----------
    say
        Told where a robot's demands are from, and what was learned of alternatives.
    lost
        The computers that are out of reach: the situation in which success counts.
    explore, seed
        Whether success is drawn from what was learned, and by which numbers.
    """
    if file.suffix != ".json":
        found = profiled(load(file))
        situation = Situation(lost=tuple(lost))
        known = learned(
            found.robot,
            actions_in(found.robot, task),
            situation=situation,
            explore=explore,
            seed=seed,
        )
        for sentence in (*found.says, *known.says):
            say(sentence)
        return known.robot, plan.problem_of(known.robot, task)
    if explore:
        raise UsageError(f"--explore: {file} is a plain problem: nothing is learned")
    if task is not None:
        raise UsageError(f"--task {task}: {file} is a plain problem and has no tasks")
    return None, plan.load(file)


def _on_computers(problem: plan.Problem, few: plan.Smallest | None) -> plan.Problem:
    """Return the problem on the computers that were chosen."""
    kept = few.computers if few else ()
    dropped = [h.name for h in problem.computers if kept and h.name not in kept]
    return plan.without(problem, dropped) if dropped else problem


def _answer(
    problem: plan.Problem,
    result: plan.Result,
    few: plan.Smallest | None,
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
    if few:
        show_smallest(few, console)
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


def _changed(
    problem: plan.Problem, without: list[str], add: list[str], scale: list[str]
) -> plan.Problem:
    """Return the problem without computers, with others, and with other capacities."""
    if without:
        problem = plan.without(problem, without)
    for text in add:
        problem = plan.add(problem, _computer(text))
    if scale:
        problem = plan.scale(problem, dict(_factor(text) for text in scale))
    return problem


def _computer(text: str) -> Computer:
    """Return the computer that ``NAME:cpu=2,memory=4GiB`` describes."""
    name, colon, rest = text.partition(":")
    if not name or not colon:
        raise UsageError(f"--add {text!r}: write NAME:cpu=2,memory=4GiB")
    pairs = [_pair(f"--add {text!r}", part) for part in rest.split(",") if part]
    return Computer(
        name=name,
        capacity={key: _amount(f"--add {text!r}", key, value) for key, value in pairs},
    )


def _factor(text: str) -> tuple[str, float]:
    """Return the name and the factor of ``NAME=0.5``."""
    name, value = _pair(f"--scale {text!r}", text)
    try:
        number = float(value)
    except ValueError:
        number = -1.0
    if not (isfinite(number) and number >= 0):
        raise UsageError(f"--scale {text!r}: {value!r} is not a number >= 0")
    return name, number


def _pair(option: str, text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise UsageError(f"{option}: {text!r} is not NAME=VALUE")
    return key.strip(), value.strip()


def _amount(option: str, resource: str, value: str) -> float:
    known = {"cpu": units.CORES, "memory": units.BYTES}
    try:
        return units.parse(value, known.get(resource, units.NUMBER))
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from None
