"""The running estimates of a whole robot, against its profile."""

from __future__ import annotations

import threading
from collections.abc import Collection

from msgspec import Struct

from poise.estimate.demand_windows import Reading
from poise.estimate.online import Drift, Estimate, RunningEstimate
from poise.estimate.profile import ConnectorProfile, Profile
from poise.manage.observe.loads import Loads
from poise.model.robot import Robot
from poise.wire.records.samples import AgentSample, ComponentSample, ConnectorSample

_COUNT_OVER = 2.0
"""Time over which a connector's rates are counted [s]."""


class DemandEstimate(Struct, frozen=True, kw_only=True):
    """What one component needs now against what its profile says.

    Parameters
    ----------
    expected
        Mean CPU by the profile [cores]; None: it has none.
    demand
        What it was placed by [cores]; 0: it has none.
    estimate
        In cores of the reference computer.
    """

    component: str
    computer: str
    expected: float | None
    demand: float = 0.0
    estimate: Estimate

    @property
    def usual(self) -> float:
        """What is expected of it [cores]; 0: nothing is known."""
        return max(self.expected or 0.0, self.demand)


class _Followed(Struct):
    """A component's running estimate, and its incarnation."""

    running: RunningEstimate
    expected: float | None
    epoch: int
    computer: str


class Estimates:
    """Takes samples, on any one thread at a time, and estimates.

    Parameters
    ----------
    robot
        Its computers' speeds turn their CPU time into the reference computer's.
    profile
        What drift is measured against; None: against what was needed at first.
    emulated
        Whether the computers are emulated: a slow one is then one that runs for a
        part of the time, and its CPU time is the reference computer's already.

    Attributes
    ----------
    loads
        The CPU use of whole computers.
    """

    def __init__(
        self, robot: Robot, profile: Profile | None, *, emulated: bool
    ) -> None:
        self._speeds = {c.name: 1.0 if emulated else c.speed for c in robot.computers}
        self._demands = {c.name: c.demand.get("cpu", 0.0) for c in robot.components()}
        self._profile = profile
        self.loads = Loads(robot, emulated=emulated)
        self._lock = threading.Lock()
        self._followed: dict[str, _Followed] = {}
        self.resting: Collection[tuple[str, int]] = ()
        """Components and epochs that are not at work: what they use is no demand."""
        self._ends: dict[tuple[str, str], tuple[float, ConnectorSample]] = {}
        self._traffic: dict[str, tuple[str, ConnectorProfile]] = {}

    def take(self, sample: AgentSample) -> list[tuple[str, Drift]]:
        """Take a sample; return the components whose demand has shifted by it."""
        self.loads.take(sample)
        drifts = []
        with self._lock:
            for container in sample.containers:
                for component in container.components:
                    drift = self._update(component, container.at, sample.computer)
                    if drift is not None:
                        drifts.append((component.name, drift))
                key = f"{sample.computer}/{container.name}"
                for connector in container.connectors:
                    self._count(key, container.at, connector)
        return drifts

    def demand_estimates(self) -> list[DemandEstimate]:
        """Return how every component stands, by name."""
        with self._lock:
            found = [
                (name, known, known.running.estimate())
                for name, known in sorted(self._followed.items())
            ]
        return [
            DemandEstimate(
                component=name,
                computer=known.computer,
                expected=known.expected,
                demand=self._demands.get(name, 0.0),
                estimate=estimate,
            )
            for name, known, estimate in found
            if estimate is not None
        ]

    def traffic(self) -> dict[str, ConnectorProfile]:
        """Return connector -> what goes over it now, by name."""
        with self._lock:
            return {name: now for name, (_, now) in sorted(self._traffic.items())}

    def _update(
        self, component: ComponentSample, at: float, computer: str
    ) -> Drift | None:
        known = self._followed.get(component.name)
        if known is None:
            known = self._followed[component.name] = self._follow(component, computer)
        if component.epoch < known.epoch:
            return None  # the incarnation that a move leaves behind
        if component.epoch != known.epoch:
            known.running.skip_to_next()  # the counters are another incarnation's
        if (component.name, component.epoch) in self.resting:
            known.running.skip_to_next()
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
            )
        )

    def _follow(self, component: ComponentSample, computer: str) -> _Followed:
        known = self._profile and self._profile.components.get(component.name)
        expected = known.cpu.mean if known else None
        running = RunningEstimate(expected, known.repeat if known else 0.0)
        return _Followed(running, expected, component.epoch, computer)

    def _count(self, key: str, at: float, now: ConnectorSample) -> None:
        """Estimate a connector's rates over the last seconds.

        As the end says at which something went over it last.
        """
        began, before = self._ends.setdefault((key, now.name), (at, now))
        seconds = at - began
        if seconds < _COUNT_OVER:
            return
        self._ends[key, now.name] = (at, now)
        found = traffic_between(before, now, seconds)
        teller, _ = self._traffic.get(now.name, ("", None))
        if found.rate or teller == key:
            self._traffic[now.name] = key, found


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
