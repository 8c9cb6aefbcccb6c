"""How old the data of chains gets on a placement, and how late timers are.

What components do is simulated several times over, without manager and agents. The
figures are means over these robots.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from msgspec import Struct

from poise.model.robot import Chain, Robot
from poise.simulation.placed_components import PlacedComponents
from poise.simulation.workload import SimulatedWork
from poise.wire.records.status import Summary

_ROBOTS = 8
_SHORTEST, _LONGEST = 5.0, 60.0
_PERIODS = 50.0
"""Each robot is simulated for 50 of the longest period, within these times [s]."""


class PredictedHop(Struct, frozen=True, kw_only=True):
    """How old the data of a chain is when a component uses it.

    Parameters
    ----------
    median, p99
        Its age [s].
    """

    component: str
    computer: str
    median: float
    p99: float


class PredictedChain(Struct, frozen=True, kw_only=True):
    """How old the data of a chain is predicted to be at its last component.

    Parameters
    ----------
    deadline
        How old it may be [s].
    median, p99
        Its age [s].
    late
        The share of uses at which it is older than that.
    slowest
        The component before which data gets oldest.
    hops
        The components after the first one.
    """

    name: str
    deadline: float
    median: float
    p99: float
    late: float
    slowest: str
    hops: tuple[PredictedHop, ...]

    @property
    def margin(self) -> float:
        """How much older it may get than the 99th percentile [s]; below 0: it is."""
        return self.deadline - self.p99


class PredictedTimer(Struct, frozen=True, kw_only=True):
    """How a timer with a deadline is predicted to keep it.

    Parameters
    ----------
    p99
        Of the time from its release to the end of its run [s].
    late
        The share of releases that miss the deadline.
    """

    component: str
    timer: str
    deadline: float
    p99: float
    late: float


class PredictedTimes(Struct, frozen=True, kw_only=True):
    """What is predicted of a placement.

    Parameters
    ----------
    unknown
        The chains whose data does not get to their end, by what is known.
    guesses
        What was assumed, because neither profile nor robot file nor code says it.
    """

    chains: tuple[PredictedChain, ...] = ()
    timers: tuple[PredictedTimer, ...] = ()
    unknown: tuple[str, ...] = ()
    guesses: tuple[str, ...] = ()


def predict_times(
    robot: Robot, placement: Mapping[str, str], work: SimulatedWork
) -> PredictedTimes:
    """Return what is predicted of a placement.

    Parameters
    ----------
    placement
        Component -> computer, of all that runs.
    work
        What the components do.
    """
    models = [work.models[name] for name in placement if name in work.models]
    periods = [timer.timer.period for model in models for timer in model.timers]
    chains = [
        each for each in robot.chains if all(c in placement for c in each.through)
    ]
    seconds = min(_LONGEST, max(_SHORTEST, _PERIODS * max(periods, default=0.0)))
    robots = [PlacedComponents(robot, placement, work, seed) for seed in range(_ROBOTS)]
    for each in robots:
        each.run(each.now + seconds)
    found = [_chain(each, robots, placement) for each in chains]
    return PredictedTimes(
        chains=tuple(each for each in found if each is not None),
        unknown=tuple(
            chain.name
            for chain, each in zip(chains, found, strict=True)
            if each is None
        ),
        timers=tuple(_timers(robots, placement)),
        guesses=work.guesses,
    )


def _chain(
    chain: Chain, robots: list[PlacedComponents], placement: Mapping[str, str]
) -> PredictedChain | None:
    """Return what is predicted of a chain; None: its data never gets to its end."""
    hops, uses, missed = [], 0, 0
    for component in chain.through[1:]:
        statuses = [
            status
            for robot in robots
            for status in robot.chains(component)
            if status.name == chain.name
        ]
        age = _mean(status.age for status in statuses)
        uses, missed = age.count, sum(status.missed for status in statuses)
        hops.append(
            PredictedHop(
                component=component,
                computer=placement[component],
                median=age.median,
                p99=age.p99,
            )
        )
    if not uses:
        return None
    ages = [0.0, *(hop.median for hop in hops)]
    steps = [after - before for before, after in pairwise(ages)]
    return PredictedChain(
        name=chain.name,
        deadline=chain.deadline,
        median=hops[-1].median,
        p99=hops[-1].p99,
        late=missed / uses,
        slowest=hops[steps.index(max(steps))].component,
        hops=tuple(hops),
    )


def _timers(
    robots: list[PlacedComponents], placement: Mapping[str, str]
) -> Iterator[PredictedTimer]:
    for component in placement:
        for same in zip(*(robot.timers(component) for robot in robots), strict=True):
            first, releases = same[0], sum(timer.releases for timer in same)
            if first.deadline is None or not releases:
                continue
            took = _mean(timer.duration for timer in same)
            late = _mean(timer.lateness for timer in same)
            yield PredictedTimer(
                component=component,
                timer=first.name,
                deadline=first.deadline,
                p99=late.p99 + took.p99,
                late=sum(timer.missed for timer in same) / releases,
            )


def _mean(summaries: Iterable[Summary]) -> Summary:
    """Return what several summaries say, by their numbers of values."""
    known = [each for each in summaries if each.count]
    count = sum(each.count for each in known)
    if not count:
        return Summary()
    mean, median, p99 = (
        sum(each.count * getattr(each, name) for each in known) / count
        for name in ("mean", "median", "p99")
    )
    return Summary(count, mean, median, p99, max(each.maximum for each in known))
