"""When an agent reports its status: at each change, and now and then."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from poise.clock import Clock
from poise.wire.records.status import AgentStatus, ContainerStatus

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
        self, publish: Callable[[AgentStatus], object], clock: Clock, first: AgentStatus
    ) -> None:
        self._publish = publish
        self._clock = clock
        self._known: dict[str, _Known] = {}
        self._seen = 0, self._states(first)
        self._missed, self._sent = 0, 0.0
        self.due = 0.0

    def note(self, status: AgentStatus, arrivals: int) -> None:
        """Publish a status if it says something new, or if it is due.

        Parameters
        ----------
        arrivals
            How many managers have come: one that came waits for it.
        """
        seen = arrivals, self._states(status)
        missed = sum(known.missed for known in self._known.values())
        if missed != self._missed:
            self.due = min(self.due, self._sent + _MISSES_EVERY)
        if seen != self._seen or self._clock.now() >= self.due:
            self._publish(status)
            self._seen, self._missed = seen, missed
            self._sent = self._clock.now()
            self.due = self._sent + REPORT_EVERY

    def _states(self, status: AgentStatus) -> tuple[object, ...]:
        """Return the part of a status whose change is sent at once."""
        before, self._known = self._known, {}
        for container in status.containers:
            known = before.get(container.name)
            # most containers have said nothing since the last time
            if known is None or known.status is not container:
                known = _known_of(container)
            self._known[container.name] = known
        health = [(health.name, health.state) for health in status.health]
        last = status.faults[-1].number if status.faults else 0
        errors = [(error.where, error.count) for error in status.errors]
        found = (status.generation, status.token, last, bool(status.cut_off), errors)
        states = [known.states for known in self._known.values()]
        return (*found, health, states)


class _Known(NamedTuple):
    """What a container has said: the states in it, and how many deadlines it missed."""

    status: ContainerStatus
    states: object
    missed: int


def _known_of(status: ContainerStatus) -> _Known:
    components = [(each.name, each.state, each.errors) for each in status.components]
    connectors = [(each.name, each.ready) for each in status.connectors]
    timers = (timer for each in status.components for timer in each.timers)
    missed = sum(timer.missed for timer in timers)
    return _Known(status, (components, connectors), missed)
