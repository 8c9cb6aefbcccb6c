"""Decides where components run so that chains and timers keep their deadlines.

How old data gets, and when a timer's run ends, depends on all that runs beside it: a
placement is decided by what can be summed (`limits_of_work`), simulated, and decided
again with what was missing from the sums; at last, what is near the best is simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from math import inf, isclose

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.model.robot import Robot
from poise.plan import TimeLimit
from poise.plan.alternatives import given_up
from poise.session.placing.limits_of_work import chain_limits, timer_limits
from poise.session.profiling.stored_profiles import read_profile
from poise.session.robot_file import with_code
from poise.simulation.predicted_times import (
    PredictedTimes,
    predict_times,
    predict_uncrowded,
)
from poise.simulation.workload import SimulatedWork, workload_of

SURE = 1.25
"""What is predicted counts 1.25 times, as predictions may be wrong."""
_ROUNDS = 8
_STARTS, _NEAR, _SIMULATED = 3, 8, 24
"""Where something is late, up to 8 placements near each of the three best ones, and
near what is better there, are simulated; 24 in all."""
_SUMMED = 500
"""So many of each phase are summed at most to find those."""
_ROUNDING = 1e-6

Predict = Callable[..., Iterator[tuple[str, PredictedTimes]]]
"""Yields what is predicted of each phase of a result."""
Solve = Callable[..., plan.TaskResult]
"""Decides a problem, by another `method` if one is given."""


class DecidedByTime(Struct, frozen=True):
    """A placement of each phase, and what is predicted of it; none: no deadlines."""

    task_result: plan.TaskResult
    predicted: Mapping[str, PredictedTimes] = {}


def decide_by_time(
    robot: Robot,
    problem: plan.TaskProblem,
    *solvers: Solve,
    check: Callable[[], None] | None = None,
) -> DecidedByTime:
    """Return the best placement found, with the times that are predicted for it.

    `robot`: what its code says of deadlines of timers counts, if it was read. If it has
    chains and its code was not read yet, another process imports it.
    `solvers`: the next one decides when what one decides was looked at already.
    `check`: called before each simulation; what it raises is raised.
    """
    if any(phase.problem.time_limits for phase in problem.phases):
        robot = with_code(robot)
    elif all(t.deadline is None for code in robot.code.values() for t in code.timers):
        return DecidedByTime(solvers[0](problem))
    work = workload_of(robot, read_profile(robot))
    chains = {each.name: each for each in chain_limits(robot, work)}
    timers = tuple(timer_limits(work))
    problem = problem.changed(lambda each: _with_limits(each, chains, timers))
    free = solvers[0](problem.changed(_without_prices))
    if free.total is None:
        return DecidedByTime(free)
    predict = partial(_predicted, robot, work, check)
    found = _tried(problem, solvers, predict)
    starts = _distinct(found) or [DecidedByTime(free)]
    if len(solvers) > 1:
        best = _improved(starts[:_STARTS], problem, predict)
    else:
        best = _as_predicted(starts[0], problem, predict)
    _settle(best.task_result, free)
    return best


def _tried(
    problem: plan.TaskProblem, solvers: Sequence[Solve], predict: Predict
) -> list[DecidedByTime]:
    """Return placements with what is predicted of them, until nothing is late."""
    found: list[DecidedByTime] = []
    calibrated = problem
    for _ in range(_ROUNDS):
        for solve in solvers:
            result = solve(calibrated)
            if result.total is None:
                return found
            same = (d for d in found if _placed(d.task_result) == _placed(result))
            known = next((each.predicted for each in same), None)
            found.append(DecidedByTime(result, known or dict(predict(result))))
            if known is None:
                break
        is_over = result.stopped_by == "interrupted" or not any(_excesses(found[-1]))
        if known is not None or is_over:
            break
        alone = dict(predict(result, predict_uncrowded))
        calibrated = _with_predictions(problem, found[-1], alone, calibrated)
    return found


def _distinct(found: Sequence[DecidedByTime]) -> list[DecidedByTime]:
    """Return different placements, the best first.

    None suspends more than another does. Of two decisions for the same, the last one:
    what it was decided by is what was predicted of it.
    """
    distinct: list[DecidedByTime] = []
    least = min(map(_given_up, found), default=[])
    latest_first = [each for each in found[::-1] if _given_up(each) == least]
    for decided in sorted(latest_first, key=_total):
        placed = _placed(decided.task_result)
        if all(placed != _placed(other.task_result) for other in distinct):
            distinct.append(decided)
    return distinct


def _given_up(decided: DecidedByTime) -> list[int]:
    """Return the priorities of what is suspended in all phases, highest first."""
    results = decided.task_result.results
    priorities = (
        priority
        for phase in decided.task_result.problem.phases
        for priority in given_up(phase.problem, results[phase.name].suspended)
    )
    return sorted(priorities, reverse=True)


def _improved(
    starts: Sequence[DecidedByTime], problem: plan.TaskProblem, predict: Predict
) -> DecidedByTime:
    """Return the best of some placements, and of those near that are better.

    Sums that are fitted to one placement say of others only what may be better: those
    that promise most are simulated.
    """
    seen = [_placed(start.task_result) for start in starts]
    most = len(seen) + _SIMULATED
    good: list[DecidedByTime] = []
    for start in starts:
        here: DecidedByTime | None = start
        while here is not None:
            good.append(_as_predicted(here, problem, predict))
            late = {limit.name for limit, _ in _late(here)}
            if not late:
                return min(good, key=_total)
            here = _better(good[-1], late, seen, most, predict)
    return min(good, key=_total)


def _better(
    here: DecidedByTime,
    late: Collection[str],
    seen: list[Mapping[str, Mapping[str, str]]],
    most: int,
    predict: Predict,
) -> DecidedByTime | None:
    """Return a better placement near one where something is `late`, if one is found."""
    total = _total(here)
    near = sorted(
        _neighbours(here.task_result, late),
        key=lambda result: inf if result.total is None else result.total,
    )
    new = (result for result in near if _placed(result) not in seen)
    for result in islice(new, min(_NEAR, most - len(seen))):
        seen.append(_placed(result))
        found = DecidedByTime(result, dict(predict(result)))
        if _total(found) < total - _ROUNDING:
            return found
    return None


def _neighbours(
    result: plan.TaskResult, late: Collection[str]
) -> Iterator[plan.TaskResult]:
    """Yield what keeps all limits with one component moved, or two changed round."""
    problem = result.problem
    for phase in problem.phases:
        placed = result.results[phase.name]
        changes = _changes(phase.problem, placed.placement, late)
        for change in islice(changes, _SUMMED):
            there = {**placed.placement, **change}
            changed = _evaluated(phase.problem, placed, there)
            if changed.feasible:
                results = {**result.results, phase.name: changed}
                yield replace(result, results=results)


def _evaluated(
    problem: plan.Problem, like: plan.Result, placement: Mapping[str, str]
) -> plan.Result:
    """Return what can be said of a placement that suspends what another one does."""
    suspended, why = like.suspended, like.choice.why
    found = plan.evaluate(problem, placement, like.method, suspended=suspended, why=why)
    found.seconds, found.seed = like.seconds, like.seed
    found.stopped_by = like.stopped_by
    return found


def _changes(
    problem: plan.Problem, placement: Mapping[str, str], late: Collection[str]
) -> Iterator[Mapping[str, str]]:
    """Yield moves of late parts and of what is beside them, and swaps with parts."""
    limits = [each for each in problem.time_limits if each.name in late]
    needed = {name for each in limits for name in each.components}
    parts = [name for name in placement if name in needed]
    crowded = {placement[part] for part in parts}
    for component, here in placement.items():
        for computer in problem.computers if here in crowded else ():
            if computer.name != here:
                yield {component: computer.name}
    for index, part in enumerate(parts):
        for other, there in placement.items():
            if there != placement[part] and other not in parts[:index]:
                yield {part: there, other: placement[part]}


def _settle(result: plan.TaskResult, free: plan.TaskResult) -> None:
    """Say what is proven of a placement.

    What was predicted of some placements proves nothing of others; but no F is below
    what it would be if nothing could be late, as in `free`.
    """
    for name, each in result.results.items():
        by = free.results[name]
        is_same = by.suspended == each.suspended
        bound = by.bound if is_same and by.bound is not None else -inf
        total = each.objective.total if each.objective else inf
        each.settle(bound, proven=is_same and by.proven and total <= bound + _ROUNDING)
    is_same = all(
        each.suspended == free.results[name].suspended
        for name, each in result.results.items()
    )
    result.bound = least = free.bound if is_same else None
    whole = inf if result.total is None else result.total
    result.proven = free.proven and least is not None and whole <= least + _ROUNDING


def _as_predicted(
    decided: DecidedByTime, summed_problem: plan.TaskProblem, predict: Predict
) -> DecidedByTime:
    """Return a placement whose F has the times that are predicted of it itself."""
    result = decided.task_result
    summed = _summed(result)
    is_told = isclose(summed, sum(_excesses(decided)), abs_tol=_ROUNDING)
    if is_told or not all(each.placement for each in result.results.values()):
        return decided
    alone = dict(predict(result, predict_uncrowded))
    problem = _with_predictions(summed_problem, decided, alone, result.problem)
    results = {
        phase.name: _evaluated(phase.problem, found, found.placement)
        for phase in problem.phases
        for found in [result.results[phase.name]]
    }
    told = replace(result, problem=problem, results=results)
    return DecidedByTime(told, decided.predicted)


def _without_prices(problem: plan.Problem) -> plan.Problem:
    """Return the problem with those time limits only that must be kept."""
    kept = (each for each in problem.time_limits if not each.price)
    return replace(problem, time_limits=tuple(kept))


def _with_limits(
    problem: plan.Problem, chains: Mapping[str, TimeLimit], timers: Iterable[TimeLimit]
) -> plan.Problem:
    """Return the problem with the runs and hops of its chains, and with its timers."""
    names = {each.name for each in problem.components}
    limits = (
        replace(chains[each.name], price=each.price) if each.name in chains else each
        for each in problem.time_limits
    )
    own = (each for each in timers if names.issuperset(each.components))
    return replace(problem, time_limits=(*limits, *own))


def _predicted(
    robot: Robot,
    work: SimulatedWork,
    check: Callable[[], None] | None,
    result: plan.TaskResult,
    predict: Callable[..., PredictedTimes] = predict_times,
) -> Iterator[tuple[str, PredictedTimes]]:
    """Yield what is predicted of each phase that has a placement."""
    here = replace(robot, computers=result.problem.computers)
    for name, each in result.results.items():
        if each.placement:
            if check is not None:
                check()
            yield name, predict(here, each.placement, work)


def _placed(result: plan.TaskResult) -> Mapping[str, Mapping[str, str]]:
    return {name: each.placement for name, each in result.results.items()}


def _total(decided: DecidedByTime) -> float:
    """Return F with the times that are predicted, not those that are summed."""
    total = decided.task_result.total or 0.0
    return total - _summed(decided.task_result) + sum(_excesses(decided))


def _summed(result: plan.TaskResult) -> float:
    """Return what the times that are summed add to F."""
    return sum(
        result.problem.weights[name] * each.objective.time
        for name, each in result.results.items()
        if each.objective is not None
    )


def _excesses(decided: DecidedByTime) -> Iterator[float]:
    """Yield what F grows by for each deadline that may not be kept."""
    return (excess for _, excess in _late(decided))


def _late(decided: DecidedByTime) -> Iterator[tuple[plan.TimeTaken, float]]:
    """Yield each deadline that may not be kept, and what F grows by for it.

    Of what is not predicted the sum counts, which it takes at least.
    """
    weights = decided.task_result.problem.weights
    for name, times in decided.predicted.items():
        ages = _ages(times)
        for each in decided.task_result.results[name].times:
            over = ages.get(each.name, each.seconds) / each.limit - 1
            if over > 0:
                yield each, weights[name] * each.price * over


def _ages(times: PredictedTimes) -> dict[str, float]:
    """Return the name of each limit that is predicted -> what counts for it [s]."""
    chains = {each.name: SURE * each.p99 for each in times.chains}
    return chains | {each.name: SURE * each.p99 for each in times.timers}


def _with_predictions(
    problem: plan.TaskProblem,
    decided: DecidedByTime,
    alone: Mapping[str, PredictedTimes],
    before: plan.TaskProblem,
) -> plan.TaskProblem:
    """Return the problem that says of the placement what is predicted of it.

    `problem`: the problem as it can be summed.
    `alone`: phase -> what is predicted if nobody waited for CPU.
    `before`: says the same of other placements, which counts for limits that this one
    does not have.
    """
    phases = []
    for phase, earlier in zip(problem.phases, before.phases, strict=True):
        result = decided.task_result.results[phase.name]
        summed = {each.name: each for each in phase.problem.time_limits}
        ages = _ages(decided.predicted.get(phase.name, PredictedTimes()))
        ages_alone = _ages(alone.get(phase.name, PredictedTimes()))
        found = _fitted_limits(summed, result, ages, ages_alone)
        fitted = {each.name: each for each in found}
        limits = tuple(fitted.get(e.name, e) for e in earlier.problem.time_limits)
        changed = replace(earlier.problem, time_limits=limits)
        phases.append(replace(earlier, problem=changed))
    return replace(before, phases=tuple(phases))


def _fitted_limits(
    summed: Mapping[str, TimeLimit],
    result: plan.Result,
    ages: Mapping[str, float],
    alone: Mapping[str, float],
) -> Iterator[TimeLimit]:
    """Yield the limits of a placement such that their sums are what is predicted.

    What would be missing from a sum if nobody waited for CPU is missing on any
    placement; the rest grows with the waiting for CPU that the sum has.
    """
    limits = [
        summed[each.name] for each in result.problem.time_limits if each.name in ages
    ]
    seconds = _seconds(result, limits)
    hops = _seconds(result, [replace(each, runs=()) for each in limits])
    for each in limits:
        name, age = each.name, ages[each.name]
        own = sum(run.seconds for run in each.runs)
        waits = max(0.0, alone.get(name, age) - hops[name] - own)
        shared, rest = seconds[name] - hops[name], age - hops[name] - waits
        if shared > 0 and rest > shared:
            factor = rest / shared
            runs = (replace(run, seconds=factor * run.seconds) for run in each.runs)
            yield replace(each, fixed=waits, runs=tuple(runs))
        else:
            yield replace(each, fixed=max(0.0, age - seconds[name]))


def _seconds(result: plan.Result, limits: Iterable[TimeLimit]) -> dict[str, float]:
    """Return the name of each limit -> its sum on a placement [s]."""
    asked = replace(result.problem, time_limits=tuple(limits))
    found = plan.evaluate(asked, result.placement, result.method)
    return {each.name: each.seconds for each in found.times}
