"""Reports on tasks, and on the switches from one action to the next."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from statistics import median
from typing import Literal

from msgspec import Struct

from poise.estimate.profiles import quantile
from poise.units import format_bytes
from poise.wire.records.status_records import Summary

TaskState = Literal["going", "waiting", "paused", "done", "failed", "cancelled"]
"""`waiting`: for what other tasks use, or for room; `paused`: on request."""
OVER = {"done", "failed", "cancelled"}
_MOST = 1000
"""The times of so many switches are kept."""


class ActionReport(Struct, frozen=True, kw_only=True):
    """An action that is due."""

    name: str
    functions: tuple[str, ...]  # what it uses
    architectures: tuple[str, ...]  # what provides that now
    worked: float  # for how long it has worked [s]
    is_at_work: bool  # whether it works now


class TaskReport(Struct, frozen=True, kw_only=True):
    """A task since it was started."""

    name: str
    state: TaskState
    priority: int
    why: str  # what it waits for, or why it ended so; else empty
    began: float  # when it was started [s since 1970]
    since: float  # when its state began [s since 1970]
    actions: tuple[ActionReport, ...] = ()  # those that are due
    next: tuple[str, ...] = ()  # the names of those that may come then


class PrefetchReport(Struct, frozen=True, kw_only=True):
    """What prefetch was good for since the start."""

    hit: Summary = Summary()  # switches to actions of which all was prepared [s]
    miss: Summary = Summary()  # switches to others [s]
    prepared: Mapping[str, str] = {}  # component -> computer, of what waits now
    memory: int = 0  # what that uses [bytes]
    wasted: int = 0  # what was used by what was dropped, and never worked [bytes]

    def __str__(self) -> str:
        said = []
        if self.hit.count:
            said.append(f"{self.hit.count} prepared ({_times(self.hit)})")
        if self.miss.count:
            said.append(f"{self.miss.count} not prepared ({_times(self.miss)})")
        if self.wasted:
            said.append(f"{format_bytes(self.wasted)} prepared for nothing")
        return ", ".join(said)


class Switches:
    """Counts switches from one action to the next."""

    def __init__(self) -> None:
        self._count = Counter[bool]()
        self._seconds = {hit: deque[float](maxlen=_MOST) for hit in (True, False)}

    def note(self, seconds: float, *, is_hit: bool) -> None:
        """Count a switch that took so long [s]."""
        self._count[is_hit] += 1
        self._seconds[is_hit].append(seconds)

    def summary(self, *, is_hit: bool) -> Summary:
        """Return how long switches took [s]; count, mean and so on of the latest."""
        times = sorted(self._seconds[is_hit])
        if not times:
            return Summary()
        return Summary(
            count=self._count[is_hit],
            mean=sum(times) / len(times),
            median=median(times),
            p99=quantile(times, 0.99),
            maximum=times[-1],
        )


def _times(seconds: Summary) -> str:
    return f"{seconds.median * 1e3:.0f} ms, p99 {seconds.p99 * 1e3:.0f} ms"
