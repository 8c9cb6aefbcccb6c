"""Journals the errors that components' code raises: when they begin, and end. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from poise.manage.agent_connections.statuses import Statuses
from poise.manage.journal import Kind
from poise.units import counted
from poise.wire.records.status import ComponentStatus, ErrorCount

QUIET = 10.0
"""Errors of one kind are over when none came for so long [s]."""
_MOST = 10
"""So many incarnations of a component are told apart; two are there in a move."""
_Key = tuple[str, str, str]
"""Component; hook, timer or port; and type of error."""


class RaisedErrors:
    """Tells errors that come now from those that came before.

    A component that failed is a deviation, and not told of here.

    Parameters
    ----------
    note
        Takes entries of the journal.
    """

    def __init__(self, note: Callable[[Kind, str], object]) -> None:
        self._note = note
        self._counts: dict[str, dict[tuple[int, int], Counter[_Key]]] = {}
        """Component -> process and incarnation -> what it has raised."""
        self._coming: dict[_Key, tuple[str, int, float]] = {}

    def look(self, statuses: Statuses, now: float) -> None:
        """Note what is new in `statuses`, and what came no more until `now` [s]."""
        for computer, status in statuses.items():
            for container in status.containers:
                for component in container.components:
                    self._look_at(component, computer, container.pid, now)
        for key, (what, count, last) in list(self._coming.items()):
            if now - last >= QUIET:
                del self._coming[key]
                self._note("right", f"no more: {what} ({counted(count, 'time')})")

    def _look_at(
        self, component: ComponentStatus, computer: str, pid: int, now: float
    ) -> None:
        known = self._counts.setdefault(component.name, {})
        before: Counter[_Key] = known.pop((pid, component.epoch), Counter())
        counts: Counter[_Key] = Counter()
        for error in component.error_counts:
            key = component.name, error.where, _last_line(error).partition(":")[0]
            counts[key] += error.count
            if counts[key] > before[key] and component.state != "failed":
                self._take(key, computer, error, counts[key] - before[key], now)
                before[key] = counts[key]
        known[pid, component.epoch] = counts
        if len(known) > _MOST:
            del known[next(iter(known))]

    def _take(
        self, key: _Key, computer: str, error: ErrorCount, new: int, now: float
    ) -> None:
        name, where, _ = key
        what = f"'{where}' of component '{name}' on '{computer}' raised "
        what, count, _ = self._coming.get(key, (what + _last_line(error), 0, now))
        if not count:
            self._note("wrong", f"{what}; `poise log {name}` shows where")
        self._coming[key] = what, count + new, now


def _last_line(error: ErrorCount) -> str:
    return error.text.rstrip().rpartition("\n")[2]
