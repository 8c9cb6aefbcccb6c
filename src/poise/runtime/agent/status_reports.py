"""When an agent reports its status: at each change, and now and then."""

from __future__ import annotations

from collections.abc import Callable

from msgspec.msgpack import encode

from poise.clock import Clock
from poise.wire.records.status import AgentStatus

REPORT_EVERY = 0.5
"""A status goes out at least this often [s]."""
_MISSES_EVERY = 0.2
"""While deadlines are missed, it goes out this often [s]."""


class StatusReports:
    """Publishes an agent's status.

    Parameters
    ----------
    first
        What is known already.

    Attributes
    ----------
    due
        When the next one goes out at the latest [s].
    """

    def __init__(
        self, publish: Callable[[bytes], object], clock: Clock, first: AgentStatus
    ) -> None:
        self._publish = publish
        self._clock = clock
        self._seen = 0, _states(first)
        self._missed, self._sent = 0, 0.0
        self.due = 0.0

    def note(self, status: AgentStatus, arrivals: int) -> None:
        """Publish a status if it says something new, or if it is due.

        Parameters
        ----------
        arrivals
            How many managers have come: one that came waits for it.
        """
        seen = arrivals, _states(status)
        if _missed(status) != self._missed:
            self.due = min(self.due, self._sent + _MISSES_EVERY)
        if seen != self._seen or self._clock.now() >= self.due:
            self._publish(encode(status))
            self._seen, self._missed = seen, _missed(status)
            self._sent = self._clock.now()
            self.due = self._sent + REPORT_EVERY


def _states(status: AgentStatus) -> tuple[object, ...]:
    """Return the part of a status whose change is sent at once."""
    components = [
        (component.name, component.state, component.errors)
        for container in status.containers
        for component in container.components
    ]
    connectors = [
        (connector.name, connector.ready)
        for container in status.containers
        for connector in container.connectors
    ]
    health = [(health.name, health.state) for health in status.health]
    last = status.faults[-1].number if status.faults else 0
    found = (status.generation, status.token, last, bool(status.cut_off))
    return (*found, health, components, connectors)


def _missed(status: AgentStatus) -> int:
    """Return how many deadlines of timers were missed on the computer."""
    return sum(
        timer.missed
        for container in status.containers
        for component in container.components
        for timer in component.timers
    )
