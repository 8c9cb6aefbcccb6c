"""The faults that agents reported after some moment. Pure.

Agents number their faults and keep them for as long as they live, also over robots, so
a reader of new ones remembers the numbers of those before.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping

from poise.manage.agent_connections.statuses import Statuses
from poise.wire.records.status_records import Fault

Numbers = Mapping[str, int]
"""Computer -> the number of its agent's last fault."""
_FIRST = 5
_WINDOW = 60.0
"""A container with more than `_FIRST` faults in this time is reported once [s]."""


def last_numbers(statuses: Statuses) -> Numbers:
    """Return the numbers of the last faults that `statuses` hold."""
    return {
        computer: max((fault.number for fault in status.faults), default=0)
        for computer, status in statuses.items()
    }


def faults_after(before: Numbers, statuses: Statuses) -> Iterator[tuple[str, Fault]]:
    """Yield computers and their faults after `before`, oldest first."""
    now = last_numbers(statuses)
    for computer, status in sorted(statuses.items()):
        known = before.get(computer, 0)
        is_new_agent = now[computer] < known
        for fault in status.faults:
            if is_new_agent or fault.number > known:
                yield computer, fault


def fault_sentence(computer: str, fault: Fault) -> str:
    """Return a fault for people."""
    restarts = f" (restarts before: {fault.restarts})" if fault.restarts else ""
    return f"container '{fault.container}' on '{computer}' {fault.message}{restarts}"


class FaultFilter:
    """Selects the faults to report: of a container with very many, one a minute.

    The first `_FIRST` faults of a container within `_WINDOW` are reported one by one.
    """

    def __init__(self, before: Numbers) -> None:
        self.count = 0
        """How many faults there were, reported or not."""
        self._known = before
        self._of: dict[tuple[str, str], _Faults] = {}

    def new(self, statuses: Statuses, now: float) -> Iterator[tuple[str, Fault]]:
        """Yield the faults to report at `now` [s] with sentences, oldest first."""
        for computer, fault in faults_after(self._known, statuses):
            self.count += not fault.is_over
            known = self._of.setdefault((computer, fault.container), _Faults())
            more = known.take(fault, now)
            if known.is_told:
                yield fault_sentence(computer, fault) + more, fault
        self._known = {**self._known, **last_numbers(statuses)}

    def close(self, computer: str, container: str) -> bool:
        """Take a container's last fault for over; return whether to report that."""
        known = self._of.get((computer, container))
        if known is None or known.is_over:
            return False
        known.is_over = True
        return known.is_told


class _Faults:
    """The latest faults of one container."""

    def __init__(self) -> None:
        self.is_told = self.is_over = False
        self._moments: deque[float] = deque(maxlen=_FIRST)
        self._told_at = float("-inf")
        self._untold = 0

    def take(self, fault: Fault, now: float) -> str:
        """Decide whether to report a fault, and return what to add to its sentence."""
        self.is_over = fault.is_over
        if fault.is_over:  # reported like the fault before, which it ends
            return ""
        self.is_told = not self._is_many(now) or now - self._told_at >= _WINDOW
        self._moments.append(now)
        if not self.is_told:
            self._untold += 1
            return ""
        more = f"; {self._untold} more since the last line" if self._untold else ""
        self._told_at, self._untold = now, 0
        return more + ("; from now on one line a minute" if self._is_many(now) else "")

    def _is_many(self, now: float) -> bool:
        return len(self._moments) == _FIRST and now - self._moments[0] < _WINDOW


def combined(faults: Iterable[Fault]) -> Iterator[str]:
    """Yield a sentence for each kind of fault, with its number and last time."""
    kinds: dict[tuple[str, str], list[Fault]] = {}
    for fault in faults:
        kinds.setdefault((fault.container, fault.message), []).append(fault)
    for (container, message), same in kinds.items():
        last = time.strftime("%H:%M:%S", time.localtime(same[-1].at))
        many = f" ({len(same)} times, last at {last})" if len(same) > 1 else ""
        yield f"container '{container}' {message}{many}"
