"""When an agent reports its status: at each change, and now and then."""

from __future__ import annotations

from collections.abc import Callable

from poise.clock import Clock
from poise.wire.records.status_records import AgentStatus

REPORT_EVERY = 0.5
"""A status goes out at least this often [s]."""
_MISSES_EVERY = 0.2
"""While deadlines are missed, it goes out this often [s]."""


class StatusReports:
    """Publishes an agent's status."""

    def __init__(
        self, publish: Callable[[AgentStatus], object], clock: Clock, first: AgentStatus
    ) -> None:
        self._publish = publish
        self._clock = clock
        self._seen = 0, first.states
        self._missed, self._sent = 0, 0.0
        self.due = 0.0

    def note(self, status: AgentStatus, arrivals: int) -> None:
        """Publish a status if it says something new, or if it is due."""
        seen = arrivals, status.states
        if status.missed != self._missed:
            self.due = min(self.due, self._sent + _MISSES_EVERY)
        if seen != self._seen or self._clock.now() >= self.due:
            self._publish(status)
            self._seen, self._missed = seen, status.missed
            self._sent = self._clock.now()
            self.due = self._sent + REPORT_EVERY
