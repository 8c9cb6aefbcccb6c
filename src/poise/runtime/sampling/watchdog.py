"""Notices containers that do not respond, and finds out why.

A control thread increments a heartbeat in the stats page, for which it needs the GIL.
When that stands still, the kernel's counters tell why: the process is stopped, a thread
holds the GIL, or it gets no CPU, which is reported only after a longer time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Protocol

from msgspec import Struct

from poise.runtime.sampling.kernel_counters import Processes

LOOK_EVERY = 0.2
"""The heartbeats are compared this often [s]."""
_SUSPICIOUS = 0.35
"""A heartbeat that stands still for longer than this is looked into [s]."""
_STARVED = 5.0
"""A container that gets no CPU for longer than this does not respond [s]."""
_LONG = 1.0
"""A container that used this much CPU time since its heartbeat is not starved [s]."""
_SHARE = 0.25
"""A thread that waits for a CPU for this share of a time is starved."""


class Silence(Struct, frozen=True, kw_only=True):
    """A container does not respond; or it responds again: then `reason` is empty."""

    container: str
    pid: int
    seconds: float  # How long it did not respond [s]
    reason: str = ""
    remedy: str = ""
    heartbeat: int = 0  # Where its heartbeat stands still
    # Whether it only gets no CPU, which may pass at any moment
    is_starved: bool = False


class WatchedPage(Protocol):
    """What the watchdog reads of a container's stats page."""

    def heartbeat(self) -> int:
        """Return how often the control thread has run; 0 before the first time."""


class _Watched:
    """What is known of one container's heartbeat."""

    def __init__(self, beat: int, now: float, cpu: float) -> None:
        self.beat, self.since, self.cpu = beat, now, cpu
        self.looked_at = 0.0
        self.delays: dict[int, float] = {}
        self.silence: Silence | None = None


class Watchdog:
    """Compares heartbeats; `look` is called every `LOOK_EVERY`."""

    def __init__(
        self,
        processes: Processes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._processes = processes or Processes()
        self._clock = clock
        self._watched: dict[int, _Watched] = {}
        self._looked_at = 0.0

    def look(
        self, containers: Iterable[tuple[str, int, WatchedPage]]
    ) -> Iterator[Silence]:
        """Yield the containers that do not respond any more, or do so again."""
        now = self._clock()
        # the watchdog itself got no CPU: nothing is known of that time
        was_away = now - self._looked_at > 2 * LOOK_EVERY
        self._looked_at = now
        before, self._watched = self._watched, {}
        for name, pid, page in containers:
            beat, known = page.heartbeat(), before.get(pid)
            if known is None or known.beat != beat or not beat:
                if known is not None and known.silence is not None:
                    lasted = now - known.since
                    yield Silence(container=name, pid=pid, seconds=lasted)
                known = _Watched(beat, now, self._processes.cpu(pid))
            elif known.silence is None:
                if was_away:
                    known.looked_at = 0.0
                found = self._diagnosis(name, pid, known, now)
                if found is not None:
                    known.silence = found
                    yield found
            self._watched[pid] = known

    def _diagnosis(
        self, name: str, pid: int, known: _Watched, now: float
    ) -> Silence | None:
        """Return why a container does not respond; None: it may yet."""
        seconds = now - known.since
        if seconds < _SUSPICIOUS:
            return None
        kernel = self._processes
        found = partial(
            Silence, container=name, pid=pid, seconds=seconds, heartbeat=known.beat
        )
        if kernel.is_stopped(pid):
            return found(
                reason="its process is stopped (SIGSTOP)",
                remedy=f"`kill -CONT {pid}` lets it go on",
            )
        delays, cpu = kernel.delays(pid), kernel.cpu(pid)
        if not known.looked_at:
            known.looked_at, known.delays = now, delays
            return None
        window = now - known.looked_at
        waited = {
            thread: delay - known.delays.get(thread, delay)
            for thread, delay in delays.items()
        }
        # where the kernel does not tell, it may be
        is_starved = not waited or max(waited.values()) > _SHARE * window
        # the kernel counts a wait when it is over: one that lasts is not in it yet
        if cpu - known.cpu < _SHARE * window and kernel.has_one_that_goes_on(pid):
            is_starved = True
        if is_starved and cpu - known.cpu < _LONG and seconds < _STARVED:
            return None
        if cpu - known.cpu >= _SHARE * window:
            reason = "a thread holds its interpreter (GIL)"
        elif is_starved:
            remedy = "Give its computer more CPU, or move components to another"
            return found(reason="it gets no CPU", remedy=remedy, is_starved=True)
        else:
            reason = "a thread waits while it holds its interpreter (GIL)"
        remedy = f"`kill -KILL {pid}` ends it, and it is started again"
        return found(reason=reason, remedy=remedy)
