"""What `poise plan` prints for people."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping

from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table

from poise import plan, units
from poise.model.robot import Computer
from poise.session.render.tables import table
from poise.simulation.predicted_times import PredictedTimes
from poise.simulation.workload import LEFT_OUT, NO_PROFILE, NO_WAITS
from poise.units import counted

BAR = 10
"""Length of a full bar [characters]."""
MOST_NAMES = 25
"""How many components of one computer are named; `--json` names all."""
ALWAYS = "communication", "balance", "move"
TERMS = (*ALWAYS, "quality", "shortage", "time")
"""The terms of F; the last ones are shown where they are not 0."""
_LATE = 0.01
"""What misses a smaller share of its deadlines is not named."""
_LEGEND = "F: the weighted sum of what a placement costs, 0 is best"
_MOST_BARS = 3
"""The most placements whose bars fit side by side."""


def plan_parts(
    task_result: plan.TaskResult, times: Mapping[str, PredictedTimes] = {}
) -> tuple[RenderableType, ...]:
    """Return what is printed of a placement, with what is predicted of each phase."""
    several = len(task_result.results) > 1
    parts = _phases(task_result) if several else _phase(task_result.only[1])
    legend = () if task_result.total is None else (f"[dim]{_LEGEND}[/]",)
    # which timers were late by what is not predicted
    left_out = (guess for guess in _guesses(times) if guess.endswith(LEFT_OUT))
    assumed = (f"[yellow]assumed: {escape(guess)}[/]" for guess in left_out)
    return (*parts, *legend, *_chains(task_result, times), *assumed)


def _chains(
    task_result: plan.TaskResult, times: Mapping[str, PredictedTimes]
) -> Iterator[RenderableType]:
    """Yield how old the data of each chain is predicted to be, if there is one."""
    phase = ("phase",) if len(times) > 1 else ()
    names = "predicted data age", "median", "p99", "deadline", "margin", "late"
    rows = table(*phase, *names, "most time to", folds=len(phase))
    for name, predicted in times.items():
        for chain in predicted.chains:
            margin = units.format_seconds(abs(chain.margin))
            is_late = chain.margin < 0
            rows.add_row(
                *(escape(each) for each in (name,) * len(phase)),
                chain.name,
                units.format_seconds(chain.median),
                units.format_seconds(chain.p99),
                units.format_seconds(chain.deadline),
                f"[bold red]-{margin}[/]" if is_late else margin,
                f"{chain.late:.1%}",
                chain.slowest,
            )
    if rows.row_count:
        yield rows
        yield from (said for said in _guesses(times) if said in {NO_PROFILE, NO_WAITS})
    told: set[str] = set()
    for name, predicted in times.items():
        where = f" in {name}" if phase else ""
        for chain in predicted.chains:
            # the 99th percentile is a mean over robots, of which a few may be late
            if chain.margin < 0 or chain.late > _LATE:
                yield _line(
                    f"chain '{chain.name}' misses its deadline{where}",
                    f"{chain.late:.0%} of its data is older than "
                    f"{units.format_seconds(chain.deadline)}; most time goes to "
                    f"{chain.slowest}",
                )
        if predicted.unknown:
            least = {e.name: e.seconds for e in task_result.results[name].times}
            ages = (
                f"{each}, at least {units.format_seconds(least[each])} old"
                for each in predicted.unknown
            )
            why = "nothing is known to carry data to the end"
            reasons = [why, *(g for g in predicted.guesses if g not in told)]
            told.update(reasons)
            yield _line(
                f"not predicted{where}", f"{'; '.join(ages)}: {'; '.join(reasons)}"
            )
        late = [
            f"{timer.component}.{timer.timer} {timer.late:.0%}"
            for timer in predicted.timers
            if timer.late >= _LATE
        ]
        if late:
            yield _line(f"predicted to miss deadlines{where}", ", ".join(late))


def _guesses(times: Mapping[str, PredictedTimes]) -> Iterable[str]:
    return dict.fromkeys(g for predicted in times.values() for g in predicted.guesses)


def _phase(result: plan.Result) -> tuple[RenderableType, ...]:
    """Return a result: placement and load by computer, then the terms of F."""
    if result.objective is None:
        return (_line("no placement", result.reason),)
    problem = result.problem
    resources = problem.resources
    rows = table("computer", "components", *map(escape, resources), folds=1)
    held: dict[str, list[str]] = {computer.name: [] for computer in problem.computers}
    for component, there in result.placement.items():
        held[there].append(component)
    used = _used(problem, result)
    for computer in problem.computers:
        bars = [_bar(computer, r, used[computer.name, r]) for r in resources]
        some = _some(held[computer.name])
        rows.add_row(escape(computer.name), escape(some), *bars)
    parts: list[RenderableType] = [rows]
    if not result.feasible:
        parts.append(_line("not feasible", result.reason))
    if result.suspended:
        why = f" (not everything fits: {result.reason})" if result.feasible else ""
        parts.append(_line("suspended", f"{', '.join(result.suspended)}{why}"))
    chosen = result.architectures.items()
    parts += [escape(f"{what}: by {by}") for what, by in chosen]
    parts += _short(result)
    parts.append(_terms(result, result.objective))
    if result.unknown:
        is_all = len(result.unknown) == len(result.placement)
        whose = "any component" if is_all else _some([*result.unknown])
        cure = "measure it with `poise profile`, or write it into the file"
        known = f"of {whose}, so none is counted: {cure}"
        parts.append(_line("no demand is known", known))
    return tuple(parts)


def _short(result: plan.Result, where: str = "") -> list[str]:
    """Return what computers are short of, where that is shared."""
    return [
        _line(
            f"short on {lack.computer}{where}",
            f"{units.format_amount(lack.resource, lack.amount)} of {lack.resource}",
        )
        for lack in result.shortages
    ]


def _line(head: str, text: str) -> str:
    return f"[bold red]{escape(head)}[/]: {escape(text)}"


def smallest_line(few: plan.Smallest, price: float) -> str:
    """Return on which computers everything fits, and for what price."""
    known = "no cheaper set will do" if few.proven else "a cheaper set may do"
    names = escape(", ".join(few.computers))
    return f"fits on {len(few.computers)}, price {price:.12g}: {names}; {known}"


def _some(names: list[str]) -> str:
    more = len(names) - MOST_NAMES
    said = ", ".join(names[:MOST_NAMES])
    return f"{said} and {more} more" if more > 0 else said


def _used(
    problem: plan.Problem, result: plan.Result
) -> defaultdict[tuple[str, str], float]:
    """Return what a placement uses of each computer's resources."""
    used: defaultdict[tuple[str, str], float] = defaultdict(float)
    for component in problem.components:
        there = result.placement.get(component.name)
        if there is not None:
            for resource, amount in component.demand.items():
                used[there, resource] += amount
    return used


def _bar(computer: Computer, resource: str, used: float) -> str:
    """Return how much of a resource is used, as a bar and a share of the capacity."""
    text, capacity = _share(computer, resource, used), computer.total(resource)
    if capacity <= 0:
        return text
    full = min(BAR, round(used / capacity * BAR))
    return f"{'█' * full}{'░' * (BAR - full)} {text:>4}"


def _share(computer: Computer, resource: str, used: float) -> str:
    """Return which share of a capacity is used; where there is none, how much is."""
    capacity = computer.total(resource)
    if capacity <= 0:
        return units.format_amount(resource, used) if used else "none"
    return f"{used / capacity:.0%}"


def _phases(task_result: plan.TaskResult) -> tuple[RenderableType, ...]:
    """Return the phases of a task side by side, then what moves between them."""
    computers = task_result.problem.computers
    names = (computer.name for computer in computers)
    rows = table("phase", "weight", *names, "F", "")
    for column in rows.columns[2:-2]:
        column.no_wrap = False
    weights = task_result.problem.weights
    for name, result in task_result.results.items():
        cells = [_on(computer, result) for computer in computers]
        rows.add_row(
            escape(name),
            f"{100 * weights[name]:.3g}%",
            *cells,
            _term(result, "total"),
            _verdict(result),
        )
    parts: list[RenderableType] = [rows]
    parts += [
        _line(f"suspended in {name}", ", ".join(result.suspended))
        for name, result in task_result.results.items()
        if result.suspended
    ]
    for name, result in task_result.results.items():
        parts += _short(result, f" in {name}")
    if task_result.reason:
        head = "not everything fits" if task_result.feasible else "not feasible"
        parts.append(_line(head, task_result.reason))
    for name, result in task_result.results.items():
        parts += [f"{name}: {f} by {by}" for f, by in result.architectures.items()]
    parts += [
        f"{move.component} moves from {move.source} to {move.target} between "
        f"{move.before} and {move.after}"
        for move in task_result.moves
    ]
    parts += [f"assumed: {escape(each)}" for each in task_result.problem.assumed]
    parts.append(_sum(task_result))
    return tuple(parts)


def _verdict(result: plan.Result) -> str:
    """Return whether a phase fits."""
    if result.feasible and not result.shortages:
        return "fits"
    return f"[bold red]{'is short' if result.feasible else 'does not fit'}[/]"


def _on(computer: Computer, result: plan.Result) -> str:
    """Return what a phase uses of a computer, and which components are there."""
    if not result.placement:
        return "-"
    used = _used(result.problem, result)
    shares = [
        f"{resource} {_share(computer, resource, used[computer.name, resource])}"
        for resource in result.problem.resources
        if computer.total(resource) > 0
    ]
    names = [c for c, there in result.placement.items() if there == computer.name]
    return f"{', '.join(shares)}\n{_some(names)}"


def _sum(result: plan.TaskResult) -> str:
    """Return the mean of F over the phases, and what moves add."""
    time = units.format_seconds(result.seconds)
    if result.total is None:
        return f"decided in {time}"
    phases = result.total - result.of_moves
    known = _known(result.bound, is_least=result.proven and result.feasible)
    return (
        f"F = {_cost(result.total)} = {counted(len(result.results), 'phase')} "
        f"{_cost(phases)} + {counted(len(result.moves), 'move')} "
        f"{_cost(result.of_moves)}{known}; in {time}"
        f"{', interrupted' if result.stopped_by == 'interrupted' else ''}"
    )


def comparison_parts(
    problem: plan.Problem, results: Mapping[str, plan.Result]
) -> Iterator[RenderableType]:
    """Yield results side by side: the terms of F, then load by computer."""
    names = list(results)
    rows = table("", *map(escape, names))
    rows.add_row("total", *(_term(results[name], "total") for name in names))
    for label in TERMS:
        values = [_term(results[name], label) for name in names]
        if label in ALWAYS or {*values} - {"0", "-"}:
            rows.add_row(label, *values)
    rows.add_row("lower bound", *(_number(results[n].bound) for n in names))
    rows.add_row("proven", *("yes" if results[n].proven else "no" for n in names))
    rows.add_row("feasible", *("yes" if results[n].feasible else "NO" for n in names))
    times = (units.format_seconds(results[name].seconds) for name in names)
    rows.add_row("decided in", *times)
    load = _bar if len(names) <= _MOST_BARS else _share
    placed = [r.objective is not None for r in results.values()]
    used = [_used(problem, result) for result in results.values()]
    for computer in problem.computers:
        for resource in problem.resources:
            loads = (load(computer, resource, u[computer.name, resource]) for u in used)
            rows.add_row(
                escape(f"{computer.name} {resource}"),
                *(
                    x if is_placed else "-"
                    for x, is_placed in zip(loads, placed, strict=True)
                ),
            )
    yield rows
    for name, result in results.items():
        if result.reason:
            yield escape(f"{name}: {result.reason}")


def explanation_parts(
    explanation: plan.Explanation | plan.Rejection,
) -> Iterator[RenderableType]:
    """Yield why something is where it is, or not there, and what else would cost."""
    yield escape(str(explanation))
    if isinstance(explanation, plan.Rejection):
        yield from _with_it(explanation)
    else:
        if explanation.together:
            names = escape(", ".join(explanation.together))
            yield f"It moves together with {names}."
        yield _options(explanation)
    yield f"[dim]{_LEGEND}[/]"


def _options(explanation: plan.Explanation) -> Table:
    options = explanation.options
    terms = [
        name
        for name in TERMS
        if name in ALWAYS or any(getattr(each.change, name) for each in options)
    ]
    rows = table("computer", "F", "change", *terms, "", folds=3 + len(terms))
    for option in options:
        here = option.computer == explanation.computer
        rows.add_row(
            escape(option.computer),
            _cost(option.objective.total),
            *(
                "" if here else f"{getattr(option.change, name):+.4g}"
                for name in ("total", *terms)
            ),
            escape(option.obstacle) or ("here" if here else ""),
        )
    return rows


def _with_it(rejection: plan.Rejection) -> Iterator[Table]:
    if rejection.objective is None or rejection.change is None:
        return
    names = ("total", *TERMS)
    rows = table("", *("F" if name == "total" else name for name in names))
    best = (_cost(getattr(rejection.objective, name)) for name in names)
    change = (f"{getattr(rejection.change, name):+.4g}" for name in names)
    rows.add_row("with it, at best", *best)
    rows.add_row("change", *change)
    yield rows


def _terms(result: plan.Result, terms: plan.Terms) -> str:
    parts = [
        f"{name} {_cost(cost)}"
        for name in TERMS
        if (cost := getattr(terms, name)) or name in ALWAYS
    ]
    known = _known(result.bound, is_least=result.proven)
    return (
        f"F = {_cost(terms.total)} = {' + '.join(parts)} ({result.scale} scale, "
        f"{result.spread}){known}; by {result.method} in "
        f"{units.format_seconds(result.seconds)}"
        f"{', interrupted' if result.stopped_by == 'interrupted' else ''}"
    )


def _known(bound: float | None, *, is_least: bool) -> str:
    if is_least:
        return ", proven to be the least"
    return "" if bound is None else f", at least {_cost(bound)} in any placement"


def _term(result: plan.Result, label: str) -> str:
    return _number(getattr(result.objective, label, None))


def _number(value: float | None) -> str:
    return "-" if value is None else _cost(value)


def _cost(value: float) -> str:
    """Return a term of F; what is left of rounding is 0."""
    return f"{round(value, 9) + 0.0:.6g}"
