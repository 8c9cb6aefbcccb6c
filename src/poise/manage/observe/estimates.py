"""The running estimates of a whole robot, and how they stand against its profile."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from msgspec import Struct

from poise.estimate.online import Drift, Estimate, RunningEstimate
from poise.estimate.profile import ConnectorProfile, Profile
from poise.estimate.window import Reading
from poise.manage.observe.loads import Loads
from poise.model.robot import Robot
from poise.wire.records.samples import AgentSample, ComponentSample, ConnectorSample

_COUNT_OVER = 2.0
"""A connector's rates are counted anew every so often [s]."""


class DemandEstimate(Struct, frozen=True, kw_only=True):
    """What one component needs now against what its profile says.

    Parameters
    ----------
    expected
        Mean CPU by the profile [cores]; None: it has none.
    estimate
        In cores of the reference computer.
    """

    component: str
    computer: str
    expected: float | None
    estimate: Estimate


class Traffic(Struct, frozen=True, kw_only=True):
    """What goes over one connector now, against what its profile says."""

    connector: str
    expected: ConnectorProfile | None
    now: ConnectorProfile


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
        self._profile = profile
        self.loads = Loads(robot, emulated=emulated)
        self._lock = threading.Lock()
        self._running: dict[str, RunningEstimate] = {}
        self._where: dict[str, str] = {}
        self._epochs: dict[str, int] = {}
        self._ends: dict[tuple[str, str], tuple[float, ConnectorSample]] = {}
        self._traffic: dict[str, tuple[str, ConnectorProfile]] = {}

    def take(self, sample: AgentSample) -> list[tuple[str, Drift]]:
        """Take a sample; return the components whose demand has shifted by it."""
        self.loads.take(sample)
        drifts = []
        speed = self._speeds.get(sample.computer, 1.0)
        with self._lock:
            for container in sample.containers:
                for component in container.components:
                    drift = self._update(component, container.at, speed)
                    if drift is not None:
                        drifts.append((component.name, drift))
                    self._where[component.name] = sample.computer
                key = f"{sample.computer}/{container.name}"
                for connector in container.connectors:
                    self._count(key, container.at, connector)
        return drifts

    def demand_estimates(self) -> list[DemandEstimate]:
        """Return how every component stands, by name."""
        with self._lock:
            return list(self._demand_estimates())

    def traffic(self) -> list[Traffic]:
        """Return what goes over every connector, by name."""
        known = self._profile.connectors if self._profile else {}
        with self._lock:
            return [
                Traffic(connector=name, expected=known.get(name), now=now)
                for name, (_, now) in sorted(self._traffic.items())
            ]

    def _update(
        self, component: ComponentSample, at: float, speed: float
    ) -> Drift | None:
        name = component.name
        if component.epoch < self._epochs.get(name, 0):
            return None  # the incarnation that a move leaves behind
        running = self._running.get(name)
        if running is None:
            running = self._running[name] = RunningEstimate(
                self._expected(name), self._repeat(name)
            )
        elif component.epoch != self._epochs[name]:
            running.skip_to_next()  # the counters are another incarnation's
        self._epochs[name] = component.epoch
        return running.update(
            Reading(
                at,
                component.cpu * speed,
                component.wait * speed,
                component.asked,
                component.done,
            )
        )

    def _expected(self, name: str) -> float | None:
        known = self._profile.components.get(name) if self._profile else None
        return known.cpu.mean if known else None

    def _repeat(self, name: str) -> float:
        known = self._profile.components.get(name) if self._profile else None
        return known.repeat if known else 0.0

    def _demand_estimates(self) -> Iterator[DemandEstimate]:
        for name, running in sorted(self._running.items()):
            estimate = running.estimate()
            if estimate is not None:
                yield DemandEstimate(
                    component=name,
                    computer=self._where[name],
                    expected=self._expected(name),
                    estimate=estimate,
                )

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
