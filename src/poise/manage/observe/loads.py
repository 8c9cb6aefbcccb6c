"""The CPU use of whole computers: the robot's, and that of other programs."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping

from msgspec import Struct

from poise.model.robot import Robot
from poise.wire.records.samples import AgentSample, ContainerSample

FULL = 0.95
"""A computer that uses this share of its CPU or more has none left."""
OVER = 0.5
"""A load is the mean over this time [s]."""
_NOTICEABLE = 0.02
"""Less use by other programs may be the kernel's own work [cores]."""


class Load(Struct, frozen=True, kw_only=True):
    """The CPU use of one computer lately [cores of the reference].

    Parameters
    ----------
    capacity
        What the computer has.
    used
        By all programs.
    background
        By programs that are not the robot's; it counts in `used`.
    components
        By each component there; they count in `used`.
    """

    capacity: float
    used: float
    background: float = 0.0
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


class Loads:
    """Takes samples, on any one thread at a time.

    Parameters
    ----------
    robot
        Its computers' speeds turn their CPU time into the reference computer's.
    emulated
        Whether their CPU time is the reference computer's already.
    """

    def __init__(self, robot: Robot, *, emulated: bool) -> None:
        self._speeds = {c.name: 1.0 if emulated else c.speed for c in robot.computers}
        self._capacities = {c.name: c.total("cpu") for c in robot.computers}
        self._totals: dict[str, deque[_Total]] = {}
        self._lock = threading.Lock()

    def take(self, sample: AgentSample) -> None:
        """Take a sample; one that does not tell the computer's CPU time is ignored."""
        if sample.busy is None or sample.computer not in self._capacities:
            return
        total = _Total(
            sample.at,
            sample.busy,
            sample.cpu,
            {each.pid: _used(each) for each in sample.containers},
            {c.name: c.cpu for each in sample.containers for c in each.components},
        )
        with self._lock:
            totals = self._totals.setdefault(sample.computer, deque())
            if totals and (total.at <= totals[-1].at or total.all < totals[-1].all):
                totals.clear()  # its agent was restarted
            totals.append(total)
            while len(totals) > 1 and totals[-1].at - totals[1].at >= OVER:
                totals.popleft()

    def loads(self) -> dict[str, Load]:
        """Return computer -> load, where enough of it was seen."""
        with self._lock:
            windows = {c: (t[0], t[-1]) for c, t in self._totals.items()}
        return {
            name: self._load(name, before, after)
            for name, (before, after) in windows.items()
            if after.at - before.at >= OVER
        }

    def _load(self, name: str, before: _Total, after: _Total) -> Load:
        seconds, speed = after.at - before.at, self._speeds[name]
        used = after.all - before.all
        own = after.agent - before.agent
        # what a container used that began or ended meanwhile is not known in full
        own += sum(
            cpu - before.containers.get(pid, 0.0)
            for pid, cpu in after.containers.items()
        )
        background = (used - own) / seconds * speed
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


def _used(container: ContainerSample) -> float:
    """Return a container's CPU time, with that of the commands that it runs [s]."""
    return max(container.cpu, sum(each.cpu for each in container.components))
