"""What an agent knows of each container's health: state, restarts, faults."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping

from msgspec import Struct, structs

from poise.clock import wall_time
from poise.wire.records.status_records import ContainerHealth, ContainerState, Fault

_MOST_FAULTS = 100
_MOST_RESTARTS = 100
_LATELY = 60.0
"""Restarts within this time are counted as `restarts_lately` [s]."""


class ContainerUse(Struct, frozen=True):
    """What a container uses."""

    cpu: float = 0.0
    memory: int = 0
    growth: float = 0.0
    limit: float = 0.0
    full_in: float = 0.0


Usage = Mapping[str, ContainerUse]
"""Container -> what it uses; the agent itself has an empty name."""
_NOTHING = ContainerUse()


class HealthRecords:
    """The health of all containers that an agent has run, for as long as it lives."""

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = wall_time,
    ) -> None:
        self._clock = clock
        self._wall = wall
        self._born = clock()
        self._restarts: dict[str, deque[float]] = {}
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self._number = 0
        self._of: dict[str, ContainerHealth] = {}

    def note_start(self, container: str) -> None:
        """Record that a container is started; after a fault that is a restart."""
        known = self._of.get(container)
        restarts = known.restarts if known else 0
        if known and known.state == "restarting":
            restarts += 1
            recent = self._restarts.setdefault(container, deque(maxlen=_MOST_RESTARTS))
            recent.append(self._clock())
        self._enter(container, "starting", restarts=restarts)

    def enter(self, container: str, state: ContainerState, reason: str = "") -> None:
        """Record a container's state; harmless when repeated."""
        known = self._of.get(container)
        if known is None or (known.state, known.reason) != (state, reason):
            self._enter(container, state, reason=reason)

    def note_fault(
        self, container: str, message: str, *, is_over: bool = False
    ) -> None:
        """Record that something went wrong, or that it is over."""
        self._number += 1
        known = self._of.get(container)
        fault = Fault(
            container=container,
            message=message,
            number=self._number,
            at=self._wall(),
            uptime=self._clock() - self._born,
            restarts=known.restarts if known else 0,
            is_over=is_over,
        )
        self._faults.append(fault)
        if known is None:
            self._enter(container, "restarting")
        self._of[container] = structs.replace(self._of[container], last_fault=fault)

    def forget(self, container: str) -> None:
        """Record that a container is not wanted any more; its faults are kept."""
        self._restarts.pop(container, None)
        known = self._of.get(container)
        if known is not None and known.last_fault is None:
            del self._of[container]
        elif known is not None:
            self.enter(container, "stopped")

    def of(self, container: str) -> ContainerHealth | None:
        """Return what is known of a container."""
        return self._of.get(container)

    def faults(self) -> tuple[Fault, ...]:
        """Return the latest faults, oldest first."""
        return tuple(self._faults)

    def records(self, usage: Usage) -> tuple[ContainerHealth, ...]:
        """Return the health of all containers, with what they use now."""
        since, found = self._clock() - _LATELY, []
        for name, health in self._of.items():
            used = structs.asdict(usage.get(name, _NOTHING))
            lately = sum(moment > since for moment in self._restarts.get(name, ()))
            found.append(structs.replace(health, **used, restarts_lately=lately))
        return tuple(found)

    def _enter(
        self,
        container: str,
        state: ContainerState,
        reason: str = "",
        restarts: int | None = None,
    ) -> None:
        known = self._of.get(container) or ContainerHealth(
            name=container, state=state, since=0.0
        )
        self._of[container] = structs.replace(
            known,
            state=state,
            since=self._wall(),
            reason=reason,
            restarts=known.restarts if restarts is None else restarts,
        )
