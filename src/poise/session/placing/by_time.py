"""Decides where components run so that the data of chains is in time.

What a chain's data waits for where it is (a timer's next run, the turn of others) is
part of what is predicted of a whole placement, and not of these: see `by_time`.

How old data gets depends on all that runs beside it, which no sum over components and
connectors tells. So a placement is decided by what can be summed (`chain_limits`),
simulated, and decided again with what was missing from the sums, until the data is in
time or nothing changes any more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.estimate.demands import kinds_together
from poise.manage.deploy.deployment_plan import DeploymentPlan
from poise.model.robot import Chain, Connector, Robot
from poise.plan import Hop, Run, TimeLimit
from poise.session.profiling.stored_profiles import read_profile
from poise.session.robot_file import with_code
from poise.simulation.components.models import ComponentModel, HandlerModel
from poise.simulation.predicted_times import PredictedTimes, predict_times
from poise.simulation.workload import SimulatedWork, workload_of


def chain_limits(robot: Robot, work: SimulatedWork) -> Iterator[TimeLimit]:
    """Yield what the data of each chain passes from end to end.

    `work`: what the components do.
    """
    paths = _Paths(robot, work)
    for chain in robot.chains:
        yield TimeLimit(
            name=chain.name,
            limit=chain.deadline,
            runs=tuple(
                Run(component=name, seconds=handler.work)
                for name, handler in paths.runs(chain)
            ),
            hops=tuple(
                hop
                for source, target in pairwise(chain.through)
                for hop in paths.hops(source, target)
            ),
            shared=True,
        )


class _Paths:
    """Finds the runs and connectors that data passes."""

    def __init__(self, robot: Robot, work: SimulatedWork) -> None:
        self._work = work
        self._slot_of = DeploymentPlan(robot, "").slot_of
        self._kinds = kinds_together(robot)
        self._between: dict[frozenset[str], Connector] = {}
        for connector in robot.all_connectors():
            ends = frozenset(end.component for end in connector.between)
            self._between.setdefault(ends, connector)

    def runs(self, chain: Chain) -> Iterator[tuple[str, HandlerModel]]:
        """Yield components and the handlers that the data goes through, each once.

        The first component makes it when it sends it.
        """
        for component in chain.through[1:]:
            handlers = [
                handler
                for pair in pairwise(chain.through)
                if component in pair
                for handler in self._at(component, *pair)
            ]
            for handler in {id(each): each for each in handlers}.values():
                yield component, handler

    def hops(self, source: str, target: str) -> Iterator[Hop]:
        """Yield the way of data between two components."""
        connector = self._between.get(frozenset((source, target)))
        if connector is not None:
            name, traffic = str(connector), self._work.traffic
            share = 2 if name in traffic.calling else 1  # a call goes both ways
            yield Hop(
                between=(source, target),
                seconds=traffic.apart(name, self._kinds[name]),
                size=traffic.size_of(name) / share,
            )

    def _at(self, component: str, source: str, target: str) -> Iterator[HandlerModel]:
        """Yield the handlers of a component that send data on, or that take it."""
        connector = self._between.get(frozenset((source, target)))
        model = self._work.models.get(component)
        if connector is None or model is None:
            return
        slot = self._slot_of(connector)
        if connector.between[0].component == component:  # it publishes or calls
            yield from (h for h in _handlers(model) if _sends(h, slot))
        else:
            found = model.takes.get(slot) or model.serves.get(slot)
            yield found or model.other


def _handlers(model: ComponentModel) -> Iterator[HandlerModel]:
    yield from (timer.handler for timer in model.timers)
    yield from model.takes.values()
    yield from model.serves.values()


def _sends(handler: HandlerModel, slot: str) -> bool:
    return slot in handler.calls or slot in (handler.publishes or {})


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

    `robot`: if its code was not read yet, another process imports it.
    `decide`: decides a problem.
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
