"""The running estimates of a whole robot, against its profile."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from itertools import pairwise
from math import inf

from msgspec import Struct
from msgspec.structs import replace

from poise.estimate.demands import shifted_cpu_demand
from poise.estimate.online import Drift, Estimate, Reading, RunningEstimate
from poise.estimate.profiles import ConnectorProfile, Profile
from poise.model.robot import ComponentEntry, Computer, Robot
from poise.units import format_cores
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)

FULL = 0.95
"""A computer that uses this share of its CPU or more has none left."""
OVER = 0.5
"""A load is the mean over this time [s]."""
_NOTICEABLE = 0.02
"""Less use by other programs may be the kernel's own work [cores]."""


class Load(Struct, frozen=True, kw_only=True):
    """The CPU use of one computer lately [cores of the reference]."""

    capacity: float  # what the computer has
    used: float  # by all programs
    background: float = 0.0  # by programs that are not the robot's; it counts in `used`
    # by each component there; they count in `used`
    components: Mapping[str, float] = {}

    @property
    def share(self) -> float:
        """What is used of the capacity; in [0, 1], or somewhat above."""
        return self.used / self.capacity if self.capacity else 0.0

    @property
    def is_full(self) -> bool:
        """Whether no CPU is left."""
        return self.share >= FULL


class _Total(Struct, frozen=True):
    """CPU time so far [s]: of a computer, its agent, containers and components."""

    at: float
    all: float
    agent: float
    containers: Mapping[int, float]
    components: Mapping[str, float]

    def is_before(self, later: _Total) -> bool:
        """Return whether a total counts on from this one."""
        counts_on = self.all <= later.all and self.agent <= later.agent
        return self.at < later.at and counts_on


class Loads:
    """Takes samples, on any one thread at a time."""

    def __init__(self, robot: Robot, *, emulated: bool) -> None:
        self._speeds = {c.name: 1.0 if emulated else c.speed for c in robot.computers}
        self._capacities = {c.name: c.total("cpu") for c in robot.computers}
        self._totals: dict[str, deque[_Total]] = {}
        self._lock = threading.Lock()

    def add(self, sample: AgentSample) -> None:
        """Take a sample; one that does not tell the computer's CPU time is ignored."""
        if sample.busy is None or sample.computer not in self._capacities:
            return
        total = _Total(
            sample.at,
            sample.busy,
            sample.cpu,
            {container.pid: _used(container) for container in sample.containers},
            {
                c.name: c.cpu
                for container in sample.containers
                for c in container.components
            },
        )
        with self._lock:
            totals = self._totals.setdefault(sample.computer, deque())
            if totals and not totals[-1].is_before(total):
                totals.clear()  # its agent was restarted
            totals.append(total)
            while len(totals) > 1 and totals[-1].at - totals[1].at >= OVER:
                totals.popleft()

    def loads(self, without: Container[str] = ()) -> dict[str, Load]:
        """Return computer -> load, where enough was seen; `without` some computers."""
        with self._lock:
            windows = {c: (*t,) for c, t in self._totals.items() if c not in without}
        return {
            name: self._load(name, totals)
            for name, totals in windows.items()
            if totals[-1].at - totals[0].at >= OVER
        }

    def _load(self, name: str, totals: Sequence[_Total]) -> Load:
        before, after, speed = totals[0], totals[-1], self._speeds[name]
        seconds, used = after.at - before.at, after.all - before.all
        background = _by_others(totals) * speed
        return Load(
            capacity=self._capacities[name],
            used=used / seconds * speed,
            background=background if background > _NOTICEABLE else 0.0,
            components={
                component: (cpu - before.components[component]) / seconds * speed
                for component, cpu in after.components.items()
                if before.components.get(component, cpu) < cpu
            },
        )


def _by_others(totals: Sequence[_Total]) -> float:
    """Return what other programs use [cores]; not known while a container ended."""
    seconds = others = 0.0
    for before, after in pairwise(totals):
        if before.containers.keys() <= after.containers.keys():
            used = [
                c - before.containers.get(p, 0.0) for p, c in after.containers.items()
            ]
            own = after.agent - before.agent + sum(used)
            seconds += after.at - before.at
            others += after.all - before.all - own
    return others / seconds if seconds else 0.0


def _used(container: ContainerSample) -> float:
    """Return a container's CPU time, with that of the commands that it runs [s]."""
    return max(container.cpu, sum([c.cpu for c in container.components]))


_ALL_USED = 0.9
"""Where less than this share is used, CPU was to be had."""


def with_cpu_left(
    before: AgentSample | None, after: AgentSample, cores: float
) -> frozenset[int]:
    """Return the containers (processes) that could have used more CPU in between.

    The computer had some of its cores left, and so had a core, for the interpreter
    uses one.
    """
    if before is None or before.busy is None or after.busy is None:
        return frozenset()
    most = _ALL_USED * (after.at - before.at)
    if not 0 <= after.busy - before.busy < most * cores:
        return frozenset()
    began = {container.pid: container.cpu for container in before.containers}
    return frozenset(
        container.pid
        for container in after.containers
        if 0 <= container.cpu - began.get(container.pid, inf) < most
    )


_COUNT_OVER = 2.0
"""Time over which a connector's rates are counted [s]."""
_Place = tuple[str, str]
"""A computer, and a container there."""


class DemandEstimate(Struct, frozen=True, kw_only=True):
    """What one component needs now against what its profile says."""

    component: str
    computer: str
    expected: float | None  # mean CPU by the profile [cores]; None: it has none
    demand: float = 0.0  # what it was placed by [cores]; 0: it has none
    estimate: Estimate  # in cores of the reference computer

    @property
    def usual(self) -> float:
        """What is expected of it [cores]; 0: nothing is known."""
        return max(self.expected or 0.0, self.demand)


_ANY = -1
"""Less than any epoch."""


class _Followed(Struct):
    """A component's running estimate, and its incarnation."""

    running: RunningEstimate
    expected: float | None
    epoch: int
    computer: str


class Estimates:
    """Takes samples, on any one thread at a time, and estimates.

    `profile`: what drift is measured against; None: against what was needed at first.
    """

    def __init__(
        self, robot: Robot, profile: Profile | None, *, emulated: bool
    ) -> None:
        self._speeds = {c.name: 1.0 if emulated else c.speed for c in robot.computers}
        self._demands = robot.demands("cpu")
        self._cores = {c.name: c.own_cores for c in robot.computers}
        self._before: dict[str, AgentSample] = {}
        self._profile = profile
        self.loads = Loads(robot, emulated=emulated)
        self._lock = threading.Lock()
        self._followed: dict[str, _Followed] = {}
        self.idle: Collection[tuple[str, int]] = ()
        """Components and epochs that are not at work: what they use is no demand."""
        self._ends: dict[_Place, dict[str, tuple[float, ConnectorSample]]] = {}
        self._traffic: dict[str, tuple[_Place, ConnectorProfile]] = {}

    def add(self, sample: AgentSample) -> list[tuple[str, Drift]]:
        """Take a sample; return the components whose demand has shifted by it."""
        self.loads.add(sample)
        drifts = []
        computer, cores = sample.computer, self._cores.get(sample.computer, 0.0)
        with self._lock:
            had_left = with_cpu_left(self._before.get(computer), sample, cores)
            self._before[computer] = sample
            for container in sample.containers:
                is_left, at = container.pid in had_left, container.at
                for component in container.components:
                    drift = self._update(component, at, computer, had_cpu_left=is_left)
                    if drift is not None:
                        drifts.append((component.name, drift))
                self._count_all((computer, container.name), at, container.connectors)
            self._forget_ended(sample)
        return drifts

    def demand_estimates(self) -> list[DemandEstimate]:
        """Return how every component stands, by name."""
        with self._lock:
            return [
                DemandEstimate(
                    component=name,
                    computer=known.computer,
                    expected=known.expected,
                    demand=self._demands.get(name, 0.0),
                    estimate=estimate,
                )
                for name, known in sorted(self._followed.items())
                if (estimate := known.running.estimate()) is not None
            ]

    def traffic(self) -> dict[str, ConnectorProfile]:
        """Return connector -> what goes over it now, by name."""
        with self._lock:
            return {name: now for name, (_, now) in sorted(self._traffic.items())}

    def _update(
        self,
        component: ComponentSample,
        at: float,
        computer: str,
        *,
        had_cpu_left: bool,
    ) -> Drift | None:
        known = self._followed.get(component.name)
        if known is None:
            profiled = self._profile and self._profile.components.get(component.name)
            expected = profiled.cpu.mean if profiled else None
            running = RunningEstimate(expected, profiled.repeat if profiled else 0.0)
            known = _Followed(running, expected, component.epoch, computer)
            self._followed[component.name] = known
        if component.epoch < known.epoch:
            return None  # the incarnation that a move leaves behind
        is_other = component.epoch != known.epoch
        is_idle = (component.name, component.epoch) in self.idle
        if is_other and is_idle:
            return None  # the target of a move, while the source is at work
        if is_other or is_idle:
            known.running.skip_to_next()  # the counters are another incarnation's
        if is_idle:
            return None
        known.epoch, known.computer = component.epoch, computer
        speed = self._speeds.get(computer, 1.0)
        return known.running.update(
            Reading(
                at,
                component.cpu * speed,
                component.wait * speed,
                component.asked,
                component.done,
                speed,
                had_cpu_left,
            )
        )

    def _forget_ended(self, sample: AgentSample) -> None:
        """Drop the ends on a computer that are not there any more, and what they said.

        A sample has all that is there. Where a component has ended, any incarnation of
        it is followed next: that of a move's source, when the move was rolled back.
        """
        components = {
            (component.name, component.epoch)
            for container in sample.containers
            for component in container.components
        }
        for name, known in self._followed.items():
            is_here = known.computer == sample.computer
            if is_here and (name, known.epoch) not in components:
                known.epoch = _ANY
        there = {
            container.name: {connector.name for connector in container.connectors}
            for container in sample.containers
        }
        here = [(p, e) for p, e in self._ends.items() if p[0] == sample.computer]
        for place, ends in here:
            for name in ends.keys() - there.get(place[1], set()):
                del ends[name]
                if name in self._traffic and self._traffic[name][0] == place:
                    del self._traffic[name]
            if not ends:
                del self._ends[place]

    def _count_all(
        self, place: _Place, at: float, connectors: Iterable[ConnectorSample]
    ) -> None:
        """Estimate the rates of connectors, as the end says that had traffic last."""
        ends = self._ends.setdefault(place, {})
        for now in connectors:
            began, before = ends.setdefault(now.name, (at, now))
            seconds = at - began
            if seconds < _COUNT_OVER:
                continue
            ends[now.name] = at, now
            traffic = traffic_between(before, now, seconds)
            teller, _ = self._traffic.get(now.name, (None, None))
            if traffic.rate or teller == place:
                self._traffic[now.name] = place, traffic


def traffic_between(
    before: ConnectorSample, after: ConnectorSample, seconds: float
) -> ConnectorProfile:
    """Return the traffic of one end of a connector between two samples."""
    calls, messages = after.calls - before.calls, after.messages - before.messages
    if seconds <= 0 or min(calls, messages) < 0 or not calls + messages:
        return ConnectorProfile()
    return ConnectorProfile(
        calls=calls / seconds,
        messages=messages / seconds,
        size=(_bytes(after) - _bytes(before)) / (calls + messages),
    )


def _bytes(end: ConnectorSample) -> int:
    """Return the traffic in both directions [bytes]."""
    return end.bytes_out + end.bytes_in


_LEAST = 0.05
"""What takes less than this beyond its demand [cores] is no culprit."""


def culprit_on(
    load: Load | None, demand_estimates: Iterable[DemandEstimate], victim: str = ""
) -> str:
    """Return what takes most beyond what was expected on a computer, for people."""
    if load is None:
        return ""
    usual = {demand.component: demand.usual for demand in demand_estimates}
    excesses = {
        name: used - usual.get(name, 0.0)
        for name, used in load.components.items()
        if name != victim
    }
    worst = max(excesses, key=excesses.__getitem__, default="")
    excess = excesses.get(worst, 0.0)
    if max(excess, load.background) < _LEAST:
        return ""
    if load.background > excess:
        return f"other programs take {format_cores(load.background)} there"
    instead = f" instead of {format_cores(usual[worst])}" if usual.get(worst) else ""
    used = format_cores(load.components[worst])
    return f"component '{worst}' takes {used} there{instead}"


class PresentDemand(Struct, frozen=True, kw_only=True):
    """The CPU demand of a component now [cores].

    Parameters
    ----------
    mean, error
        By its estimate.
    counted
        The demand that is counted with; no more than some computer can give it.
    is_bounded
        Whether no computer could give it all.
    """

    mean: float
    error: float
    counted: float
    is_bounded: bool = False

    def __str__(self) -> str:
        """Return it with how sure it is, for people."""
        counted = f"counted as {self.counted:.1%}"
        if self.is_bounded:
            counted += ", all that any computer can give it"
        return f"{self.mean:.1%} ± {self.error:.1%} of a core now: {counted}"


def present_demands(
    robot: Robot,
    demand_estimates: Iterable[DemandEstimate],
    urgency: Mapping[str, float],
) -> dict[str, PresentDemand]:
    """Return the demands that are not what was counted with: shifted, or too small.

    `urgency`: component -> how many times what it needs counts; else once.
    """
    components, found = {c.name: c for c in robot.components()}, {}
    for need in demand_estimates:
        now, component = need.estimate, components.get(need.component)
        if component is None or now.error is None:
            continue
        demand = component.demand.get("cpu", 0.0)
        mean = urgency.get(need.component, 1.0) * now.mean
        if now.drift is None and mean - now.error <= demand:
            continue
        wanted = replace(now, mean=mean)
        needed = shifted_cpu_demand(demand, need.expected, wanted)
        usable = (_most(component, computer) for computer in robot.computers)
        most = max(usable, default=0.0)  # all of them may be out of reach
        found[need.component] = PresentDemand(
            mean=now.mean,
            error=now.error,
            counted=min(needed, most),
            is_bounded=needed > most,
        )
    return found


def _most(component: ComponentEntry, computer: Computer) -> float:
    """Return what a computer can give a component that is alone there [cores].

    One chain at a time runs a component's code, so that is one core at most; a command
    may use all.
    """
    usable = computer.usable("cpu")
    return usable if component.command else min(usable, computer.speed)
