"""`poise plan`: decide where each component runs, say why, and ask what if."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import RenderableType

from poise import plan, units
from poise.cli.main import Interrupts
from poise.cli.options import (
    AsJson,
    Set,
    arguments_of,
    busy,
    in_file,
    parse_option,
    show,
)
from poise.errors import UsageError, unknown
from poise.estimate.outcomes import Conditions
from poise.estimate.success_rates import learned, with_success
from poise.model import load
from poise.model.robot import Computer, Robot
from poise.session.placing.by_time import DecidedByTime
from poise.session.placing.placement import ALL, decided, problem_of_task
from poise.session.profiling.stored_profiles import profiled
from poise.session.render.plan_tables import (
    comparison_parts,
    explanation_parts,
    plan_parts,
    smallest_line,
)
from poise.session.render.printable import console_to
from poise.session.robot_file import with_code


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
        bool, typer.Option("--at-once", help="All of the task at once.")
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
        typer.Option(
            metavar="TIME",
            parser=partial(parse_option, "--budget", dimension=units.SECONDS),
            help="Time to decide, such as 5s; else 0.1s, or 0.26s for phases.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    steps: Annotated[
        int | None, typer.Option(help="Steps instead of time: reproducible.")
    ] = None,
    fewer: Annotated[
        bool, typer.Option("--fewer", help="Suspend what does not fit, by priority.")
    ] = False,
    share: Annotated[
        bool, typer.Option("--share", help="Share CPU where not everything fits.")
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
            help="What if this computer were gone?", autocompletion=in_file("computers")
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
        bool, typer.Option("--explore", help="Try alternatives by what they promise.")
    ] = False,
    set_: Set = None,
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
    _check_together(
        tasks, explain, phase, compare, method, smallest=smallest, at_once=at_once
    )
    _check_share(share=share, fewer=fewer, smallest=smallest)
    say = console_to(stderr=True).say
    robot = _robot(file, arguments_of(set_), tasks, say, explore=explore)

    def known(task: str | None) -> Robot | None:
        """Return the robot with what was learned of alternatives for a task."""
        if robot is None:
            return None
        conditions = Conditions(lost=tuple(without or ()))
        actions = tuple(robot.actions(task))
        believed = learned(
            robot, actions, conditions=conditions, explore=explore, seed=seed
        )
        for sentence in believed.says:
            say(sentence)
        return with_success(believed.robot, actions, conditions)

    def changed(problem: plan.Problem) -> plan.Problem:
        asked_about = changed_problem(
            problem, without or [], add or [], scale or [], fewer=fewer
        )
        return plan.share_cpu(asked_about) if share else asked_about

    if smallest and robot is not None and not tasks:
        tasks = [task.name for task in robot.tasks]
    problems = dict(_problems(file, tasks, known, at_once=at_once))
    has_phases = len(tasks) > 1 or any(len(p.phases) > 1 for p in problems.values())
    _check_phases(tasks, phase, compare, has_phases=has_phases)
    named = _architectures(problems)
    problems = {name: problem.changed(changed) for name, problem in problems.items()}
    if stranded := ", ".join(sorted(named - _architectures(problems))):
        lost = ", ".join(without or ())
        say(f"without {lost}, {stranded} can run nowhere, but an alternative can")
    with Interrupts() as interrupts:
        solve = partial(
            plan.solve_phases,
            budget=budget,
            seed=seed,
            steps=steps,
            fewer=fewer,
            stop=interrupts.has_come,
            why=not smallest,
        )
        how = partial(_decide, robot, solve, interrupts.check)
        by_method, one = partial(how, method), next(iter(problems.values()))
        if smallest:
            answer = _smallest(problems, by_method, interrupts.has_come)
        elif compare is not None:
            answer = _comparison(one, how, compare)
        else:
            answer = _decision(one, by_method, explain, phase)
        show(answer.plain, answer.parts, as_json=json)
    if not answer.is_feasible:
        raise typer.Exit(1)


class _Answer(NamedTuple):
    """What was found: whether it holds; for programs, and for people."""

    is_feasible: bool
    plain: Mapping[str, object]
    parts: Iterable[RenderableType]


def _problems(
    file: Path,
    tasks: Sequence[str],
    known: Callable[[str | None], Robot | None],
    *,
    at_once: bool,
) -> Iterator[tuple[str, plan.TaskProblem]]:
    """Yield what is to be decided for each task, or for all functions at once."""
    for name in (*tasks,) or (None,):
        if (robot := known(name)) is None:
            yield ALL, plan.TaskProblem.of_one(ALL, plan.load(file))
        else:
            yield name or ALL, problem_of_task(robot, name, at_once=at_once)


def _architectures(problems: Mapping[str, plan.TaskProblem]) -> set[str]:
    """Return the names of all architectures that may be placed."""
    phases = (phase for problem in problems.values() for phase in problem.phases)
    return {bundle.name for p in phases for bundle in p.problem.architectures}


Decider = Callable[[plan.TaskProblem], DecidedByTime]


def _decide(
    robot: Robot | None,
    solve: Callable[..., plan.TaskResult],
    check: Callable[[], None],
    method: str,
    problem: plan.TaskProblem,
) -> DecidedByTime:
    with busy("placing"):
        return decided(robot, problem, method, partial(solve, method=method), check)


def _check_together(
    tasks: list[str],
    explain: str | None,
    phase: str | None,
    compare: str | None,
    method: str,
    *,
    smallest: bool,
    at_once: bool,
) -> None:
    """Raise UsageError for options that exclude each other."""
    other = f"--explain {explain}" if explain is not None else "--smallest"
    if compare is not None and (explain is not None or smallest):
        raise UsageError(
            f"--compare and {other} exclude each other: choose one method with --method"
        )
    if smallest and explain is not None:
        raise UsageError(
            f"{other} and --smallest exclude each other: run --smallest first, then "
            "--explain with --without for the computers that are left out"
        )
    if len(tasks) > 1 and not smallest:
        raise UsageError(
            f"--task {' --task '.join(tasks)}: several tasks are planned together only "
            "with --smallest"
        )
    if phase is not None and explain is None:
        raise UsageError(f"--phase {phase} works only together with --explain")
    if at_once and len(tasks) != 1:
        raise UsageError("--at-once needs exactly one --task")
    if compare is not None and method != "auto":
        raise UsageError(
            f"--compare {compare} and --method {method} together: add {method} to "
            "--compare"
        )


def _check_share(*, share: bool, fewer: bool, smallest: bool) -> None:
    """Raise UsageError for options that disagree on whether everything must fit."""
    if smallest and fewer:
        raise UsageError(
            "--smallest and --fewer exclude each other: --smallest looks for computers "
            "on which everything fits"
        )
    if share and (fewer or smallest):
        other = "--smallest" if smallest else "--fewer"
        raise UsageError(
            f"--share and {other} exclude each other: --share lets CPU run short"
        )


def _check_phases(
    tasks: list[str], phase: str | None, compare: str | None, *, has_phases: bool
) -> None:
    """Raise UsageError for options that phases do not have, or only phases have."""
    if has_phases and compare is not None:
        raise UsageError(f"--compare: task '{tasks[0]}' has phases; add --at-once")
    if phase is not None and not has_phases:
        raise UsageError(f"--phase {phase}: this task has no phases")


def _robot(
    file: Path,
    arguments: dict[str, str],
    tasks: list[str],
    say: Callable[[str], None],
    *,
    explore: bool,
) -> Robot | None:
    """Return the robot in `file`; None when it is a plain problem."""
    if file.suffix != ".json":
        return profiled(with_code(load(file, arguments)), say)
    if arguments:
        raise UsageError(f"--set: {file} is a plain problem and has no arguments")
    if explore:
        raise UsageError(f"--explore: {file} is a plain problem: nothing is learned")
    if tasks:
        raise UsageError(
            f"--task {tasks[0]}: {file} is a plain problem and has no tasks"
        )
    return None


def _decision(
    problem: plan.TaskProblem, how: Decider, explain: str | None, phase: str | None
) -> _Answer:
    """Return what is decided, or why something is where it is."""
    answer = how(problem)
    result = answer.task_result
    several = len(result.results) > 1
    whole = result if several else result.only[1]
    plain = {**whole.to_dict(), "predicted": answer.predicted}
    if explain is not None:
        first = result.first_with(explain)
        phase = phase or first
        if phase not in result.results or result.results[phase].placement:
            explanation = result.explain(phase, explain)
            plain["explanation"] = explanation
            parts = [*explanation_parts(explanation)]
            if several:
                plain["phase"] = phase
                parts.insert(0, f"phase {phase}:")
            return _Answer(result.feasible, plain, parts)
    return _Answer(result.feasible, plain, plan_parts(result, answer.predicted))


def _smallest(
    tasks: Mapping[str, plan.TaskProblem], how: Decider, stop: Callable[[], bool]
) -> _Answer:
    """Return the cheapest computers on which each task fits, if all do."""
    problems = [*tasks.values()]
    decided: list[DecidedByTime] = []

    def decide(problem: plan.TaskProblem) -> plan.TaskResult:
        decided.append(how(problem))
        return decided[-1].task_result

    few = plan.smallest(problems, decide)
    if not few.feasible:  # why not is not looked for in each set
        for phase in few.results[-1].results.values():
            phase.find_conflict(stop)
    times = [
        next(each.predicted for each in decided if each.task_result is result)
        for result in few.results
    ]
    known = problems[0].computers
    price = sum(h.price for h in known if h.name in few.computers)
    results = dict(zip(tasks, zip(few.results, times, strict=True), strict=False))
    plain = {
        "feasible": few.feasible,
        "computers": few.computers,
        "price": price,
        "smallest_proven": few.proven,
        "tasks": {
            task: {**result.to_dict(), "predicted": predicted}
            for task, (result, predicted) in results.items()
        },
    }
    parts: list[RenderableType] = [smallest_line(few, price)] if few.feasible else []
    for task, (result, predicted) in results.items():
        if len(tasks) > 1:
            parts.append(f"\n[bold]{task}[/]")
        parts += plan_parts(result, predicted)
    return _Answer(few.feasible, plain, parts)


def _comparison(
    problem: plan.TaskProblem,
    how: Callable[[str, plan.TaskProblem], DecidedByTime],
    methods: str,
) -> _Answer:
    """Return what several methods find."""
    names = [name.strip() for name in methods.split(",")]
    results = {name: how(name, problem).task_result.only[1] for name in names}
    plain = {"results": {name: r.to_dict() for name, r in results.items()}}
    parts = comparison_parts(problem.phases[0].problem, results)
    return _Answer(any(r.feasible for r in results.values()), plain, parts)


def changed_problem(
    problem: plan.Problem,
    without: list[str],
    add: list[str],
    scale: list[str],
    *,
    fewer: bool,
) -> plan.Problem:
    """Return the problem without computers, with others, and with other capacities."""
    if without:
        problem = plan.without(problem, without, fewer=fewer)
    for text in add:
        computer = computer_of(text, "--add")
        known = dict.fromkeys(("cpu", "memory", *problem.resources))
        for resource in computer.capacity.keys() - known:
            raise UsageError(f"--add {text!r}: {unknown('resource', resource, known)}")
        problem = plan.add(problem, computer)
    if scale:
        problem = plan.scale(problem, _factors(scale))
    return problem


def computer_of(text: str, option: str) -> Computer:
    """Return the computer that ``NAME:cpu=2,memory=4GiB`` describes."""
    what = f"{option} {text!r}"
    name, colon, rest = text.partition(":")
    if not name or not colon:
        raise UsageError(f"{what}: write NAME:cpu=2,memory=4GiB")
    given: dict[str, str] = {}
    for part in filter(None, rest.split(",")):
        key, value = _pair(what, part)
        if key in given:
            raise UsageError(
                f"{what}: {key} is both {given[key]} and {value}; name it once"
            )
        given[key] = value
    return Computer(
        name=name,
        capacity={k: _amount(what, k, x) for k, x in given.items()},
    )


def _factors(texts: Sequence[str]) -> dict[str, float]:
    """Return name -> factor of ``NAME=0.5``; UsageError: a name is there twice."""
    given: dict[str, str] = {}
    factors = {}
    for text in texts:
        name, value = _pair(f"--scale {text!r}", text)
        try:
            factors[name] = float(value)
        except ValueError:
            factors[name] = -1.0
        if not (isfinite(factors[name]) and factors[name] >= 0):
            raise UsageError(f"--scale {text!r}: {value!r} is not a number >= 0")
        if (other := given.setdefault(name, text)) is not text:
            raise UsageError(
                f"--scale {other} and --scale {text} are about the same: give one"
            )
    return factors


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
