"""Decides where components run so that the data of chains is in time.

How old data gets depends on all that runs beside it, which no sum over components and
connectors tells. So a placement is decided by what can be summed (`chain_limits`),
simulated, and decided again with what was missing from the sums, until the data is in
time or nothing changes any more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.model.robot import Robot
from poise.plan import TimeLimit
from poise.session.placing.time_limits import chain_limits
from poise.session.profiling.stored_profiles import read_profile
from poise.session.robot_file import with_code
from poise.simulation.predicted_times import PredictedTimes, predict_times
from poise.simulation.workload import SimulatedWork, workload_of

SURE = 1.25
"""The predicted age of data counts 1.25 times, as predictions may be wrong."""
_ROUNDS = 4

Decide = Callable[[plan.PhasedProblem], plan.PhasedResult]


class DecidedByTime(Struct, frozen=True):
    """A placement of each phase, and what is predicted of it; none: it has no chain."""

    phased: plan.PhasedResult
    predicted: Mapping[str, PredictedTimes] = {}


def decide_by_time(
    robot: Robot, problem: plan.PhasedProblem, decide: Decide
) -> DecidedByTime:
    """Return the best placement found, with the age of data as predicted for it.

    Parameters
    ----------
    robot
        If its code was not read yet, another process imports it.
    decide
        Decides a problem.
    """
    if not any(phase.problem.time_limits for phase in problem.phases):
        return DecidedByTime(decide(problem))
    robot = with_code(robot)
    work = workload_of(robot, read_profile(robot))
    known = {each.name: each for each in chain_limits(robot, work)}
    problem = problem.changed(lambda each: _with_runs(each, known))
    found: list[tuple[float, DecidedByTime]] = []
    for _ in range(_ROUNDS):
        result = decide(problem)
        decided = DecidedByTime(result, dict(_predicted(robot, work, result)))
        is_known = any(_placed(each.phased) == _placed(result) for _, each in found)
        found.append((_total(decided), decided))
        if is_known or result.total is None or not any(_excesses(decided)):
            break
        problem = _calibrated(problem, decided)
    # the last of equally good ones: what it was decided by is what was predicted of it
    return min(reversed(found), key=lambda each: each[0])[1]


def _with_runs(problem: plan.Problem, known: Mapping[str, TimeLimit]) -> plan.Problem:
    """Return the problem whose limits have the runs and hops of chains."""
    limits = (
        replace(known[each.name], price=each.price) if each.name in known else each
        for each in problem.time_limits
    )
    return replace(problem, time_limits=tuple(limits))


def _predicted(
    robot: Robot, work: SimulatedWork, result: plan.PhasedResult
) -> Iterator[tuple[str, PredictedTimes]]:
    """Yield what is predicted of each phase that has a placement."""
    here = replace(robot, computers=result.problem.computers)
    for name, each in result.results.items():
        if each.placement:
            yield name, predict_times(here, each.placement, work)


def _placed(result: plan.PhasedResult) -> Mapping[str, Mapping[str, str]]:
    return {name: each.placement for name, each in result.results.items()}


def _total(decided: DecidedByTime) -> float:
    """Return F with the age of data that is predicted, not that which is summed."""
    weights = decided.phased.problem.weights
    summed = sum(
        weights[name] * each.objective.time
        for name, each in decided.phased.results.items()
        if each.objective is not None
    )
    return (decided.phased.total or 0.0) - summed + sum(_excesses(decided))


def _excesses(decided: DecidedByTime) -> Iterator[float]:
    """Yield what F grows by for each chain whose data may be late."""
    weights = decided.phased.problem.weights
    for name, times in decided.predicted.items():
        problem = decided.phased.results[name].problem
        prices = {each.name: each.price for each in problem.time_limits}
        for chain in times.chains:
            over = SURE * chain.p99 / chain.deadline - 1
            if over > 0:
                yield weights[name] * prices.get(chain.name, 0.0) * over


def _calibrated(
    problem: plan.PhasedProblem, decided: DecidedByTime
) -> plan.PhasedProblem:
    """Return the problem that says of the placement what is predicted of it."""
    phases = []
    for phase in problem.phases:
        times = decided.predicted.get(phase.name, PredictedTimes())
        ages = {each.name: SURE * each.p99 for each in times.chains}
        summed = {e.name: e.seconds for e in decided.phased.results[phase.name].times}
        limits = (
            replace(
                each, fixed=max(0.0, each.fixed + ages[each.name] - summed[each.name])
            )
            if each.name in ages and each.name in summed
            else each
            for each in phase.problem.time_limits
        )
        changed = replace(phase.problem, time_limits=tuple(limits))
        phases.append(replace(phase, problem=changed))
    return replace(problem, phases=tuple(phases))
