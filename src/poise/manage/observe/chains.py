"""How old the data of the robot's chains is: since the start, and lately. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import pairwise
from operator import itemgetter

from msgspec import Struct

from poise.manage.agent_connections.statuses import Statuses, connectors_of, located
from poise.model.policy import TimerValues
from poise.model.robot import Chain, Robot
from poise.units import format_seconds
from poise.wire.records.status_records import (
    ChainStatus,
    ComponentStatus,
    ConnectorStatus,
    Side,
    Summary,
    TimerStatus,
)

_ENOUGH = 2
"""Ages are taken over `OVER`, or for so long that there are as many uses."""
_LONGEST = 10.0
"""But never over a longer time [s]."""


class ChainHop(Struct, frozen=True, kw_only=True):
    """A component of a chain: how old the data was when it used it."""

    component: str
    computer: str
    epoch: int = 0
    # at each use, from the stamp on; nothing at the first component [s]
    age: Summary = Summary()
    # how long what came from the component before was under way [s]
    wire: Summary = Summary()


class ChainReport(Struct, frozen=True, kw_only=True):
    """How old the data of a chain was, since its last component began to run there."""

    name: str
    deadline: float  # how old it may be at the last component [s]
    missed: int  # how often it was older
    age: Summary  # when the last component used it [s]
    # how far ages are off at most, in the mean [s]: nobody knows better how far the
    # clocks of the chain's computers are apart. 0 on one computer
    error: float
    hops: tuple[ChainHop, ...]  # the chain's components, first to last


class ChainAge(Struct, frozen=True, kw_only=True):
    """How old the data of a chain was lately."""

    chain: str
    deadline: float
    used: int
    missed: int
    seconds: float  # how many seconds these are
    # component -> the mean age when it used data [s], first to last
    ages: Mapping[str, float]
    # component -> how long data was under way to it on a wire, in the mean [s]
    wires: Mapping[str, float]
    computers: Mapping[str, str]  # component -> computer

    @property
    def is_late(self) -> bool:
        """Whether it does not keep its deadline: a single miss is no sign."""
        return is_late(self.used, self.missed)

    @property
    def last(self) -> str:
        """The component that uses the data."""
        return list(self.ages)[-1]

    @property
    def slowest(self) -> str:
        """The component to which the data takes longest."""
        return max(self.steps(), key=itemgetter(2))[1]

    def steps(self) -> list[tuple[str, str, float]]:
        """Return how long data takes from each component's use to the next's [s]."""
        return [
            (one, next_, max(0.0, ended - began))
            for (one, began), (next_, ended) in pairwise(self.ages.items())
        ]

    def __str__(self) -> str:
        """Return which step takes how long, for people."""
        return ", ".join(
            [
                f"{one} -> {next_} {format_seconds(seconds)}"
                for one, next_, seconds in self.steps()
            ]
        )


def chain_reports(robot: Robot, statuses: Statuses) -> tuple[ChainReport, ...]:
    """Return the chains all of whose components run, in the robot file's order."""
    return ChainReader(robot).reports(statuses)


class ChainReader:
    """Reads from statuses how old the data of a robot's chains was."""

    def __init__(self, robot: Robot) -> None:
        self._chains = [(chain, _ends(robot, chain)) for chain in robot.chains]

    def reports(self, statuses: Statuses) -> tuple[ChainReport, ...]:
        """Return the chains all of whose components run, in the robot file's order."""
        if not self._chains:
            return ()
        running: dict[str, tuple[str, ComponentStatus]] = {}
        for computer, component in located(statuses):
            known = running.get(component.name)
            if known is None or known[1].epoch <= component.epoch:
                running[component.name] = computer, component
        ends = {(end.name, end.end): end for end in connectors_of(statuses)}
        return tuple(
            _report(chain, running, {n: ends[e] for n, e in into if e in ends})
            for chain, into in self._chains
            if running.keys() >= {*chain.through}
        )


def _report(
    chain: Chain,
    running: Mapping[str, tuple[str, ComponentStatus]],
    came: Mapping[str, ConnectorStatus],
) -> ChainReport:
    """Return how old the data of a chain was; `came`: where it comes to a component."""
    owns = [_own(running[name][1], chain.name) for name in chain.through]
    hops = [
        ChainHop(
            component=name,
            computer=running[name][0],
            epoch=running[name][1].epoch,
            age=own.age,
            wire=came[name].latency if name in came else Summary(),
        )
        for name, own in zip(chain.through, owns, strict=True)
    ]
    last = owns[-1]
    return ChainReport(
        name=chain.name,
        deadline=chain.deadline,
        missed=last.missed,
        age=last.age,
        error=sum([end.latency_error for end in came.values()]),
        hops=tuple(hops),
    )


def _own(component: ComponentStatus, chain: str) -> ChainStatus:
    for status in component.chains:
        if status.name == chain:
            return status
    return ChainStatus(name=chain)


def _ends(robot: Robot, chain: Chain) -> list[tuple[str, tuple[str, Side]]]:
    """Return each component and the end of a connector where data may come to it."""
    steps, ends = set(pairwise(chain.through)), list[tuple[str, tuple[str, Side]]]()
    for connector in robot.all_connectors():
        source, target = (end.component for end in connector.between)
        if (source, target) in steps:
            ends.append((target, (connector.name, "target")))
        elif (target, source) in steps:
            ends.append((source, (connector.name, "source")))
    return ends


_Sums = list[tuple[int, float]]
"""Of each component a count, and a sum of times [s]."""
_Totals = tuple[float, int, int, _Sums, _Sums]
"""When; uses and misses; ages; times on a wire."""


class ChainAges:
    """Compares the totals of reports over the last seconds."""

    def __init__(self) -> None:
        self._totals: dict[object, deque[_Totals]] = {}

    def measure(
        self, reports: Iterable[ChainReport], now: float
    ) -> tuple[ChainAge, ...]:
        """Return the chains whose data was used lately.

        `now`: a time that never goes back [s].
        """
        measured, before = [], self._totals
        self._totals = {}
        for report in reports:
            # what moved counts from 0 again
            key = report.name, *[hop.epoch for hop in report.hops]
            totals = self._totals[key] = before.get(key) or deque()
            ages = _sums([hop.age for hop in report.hops])
            wires = _sums([hop.wire for hop in report.hops])
            if not totals or totals[-1][1] != report.age.count:
                totals.append((now, report.age.count, report.missed, ages, wires))
            _forget(totals, now)
            began, used, missed, ages_before, wires_before = totals[0]
            if report.age.count > used:
                names = [hop.component for hop in report.hops]
                measured.append(
                    ChainAge(
                        chain=report.name,
                        deadline=report.deadline,
                        used=report.age.count - used,
                        missed=report.missed - missed,
                        seconds=max(OVER, now - began),
                        ages=_means(names, ages, ages_before),
                        wires=_means(names, wires, wires_before),
                        computers={h.component: h.computer for h in report.hops},
                    )
                )
        return tuple(measured)


def _forget(totals: deque[_Totals], now: float) -> None:
    """Drop the totals from before the time that counts."""
    while len(totals) > 1 and now - totals[1][0] >= OVER:
        enough = totals[-1][1] - totals[1][1] >= _ENOUGH
        if not enough and now - totals[1][0] < _LONGEST:
            return
        totals.popleft()


def _sums(summaries: Iterable[Summary]) -> _Sums:
    return [(summary.count, summary.count * summary.mean) for summary in summaries]


def _means(names: Iterable[str], after: _Sums, before: _Sums) -> dict[str, float]:
    return {
        name: (total - total_before) / max(1, count - count_before)
        for name, (count, total), (count_before, total_before) in zip(
            names, after, before, strict=True
        )
    }


_SEVERAL, _MISSED = 2, 0.2
"""A timer is late that misses as many deadlines, and this share of them."""
OVER = 1.0
"""Misses are counted over this time [s], or over two periods of a slow timer."""


def is_late(times: int, missed: int) -> bool:
    """Return whether misses are too many to be a single one among others."""
    several = missed >= _SEVERAL and missed >= _MISSED * times
    return several or 0 < times == missed


class DeadlineMisses:
    """Compares the totals of statuses over the last seconds."""

    def __init__(self) -> None:
        self._totals: dict[tuple[str, int, str], deque[tuple[float, int, int]]] = {}

    def measure(self, statuses: Statuses, now: float) -> tuple[TimerValues, ...]:
        """Return the timers with a deadline that were due lately.

        `now`: a time that never goes back [s].
        """
        measured, before = [], self._totals
        self._totals = {}
        for computer, component in located(statuses):
            for timer in component.timers:
                if timer.deadline is None:
                    continue
                key = component.name, component.epoch, timer.name
                totals = self._totals[key] = before.get(key) or deque()
                seconds = max(OVER, 2 * timer.period)
                released, missed = _count(totals, timer, now, seconds)
                if released:
                    measured.append(
                        TimerValues(
                            name=f"{component.name}.{timer.name}",
                            timer=timer.name,
                            component=component.name,
                            computer=computer,
                            released=released,
                            missed=missed,
                            share=missed / released,
                            over=seconds,
                            deadline=timer.deadline,
                            takes=timer.duration.p99,
                            late=is_late(released, missed),
                        )
                    )
        return tuple(measured)


def _count(
    totals: deque[tuple[float, int, int]], timer: TimerStatus, now: float, over: float
) -> tuple[int, int]:
    """Add a timer's totals; return what was released and missed in the time [s].

    A status comes as soon as a deadline was missed, but else only once a second: the
    timer was released evenly since the one before. The time ends with the last status.
    """
    if not totals or totals[-1][1:] != (timer.releases, timer.missed):
        if totals and totals[-1][0] == now:
            totals.pop()  # another status came within this look
        totals.append((now, timer.releases, timer.missed))
    while len(totals) > 1 and now - totals[1][0] >= over:
        totals.popleft()
    at, releases, missed = totals[0]
    if len(totals) > 1:
        next_at, later, _ = totals[1]
        past = max(0.0, totals[-1][0] - over - at) / (next_at - at)
        releases += round(past * (later - releases))
    released = timer.releases - releases
    return released, min(released, timer.missed - missed)
