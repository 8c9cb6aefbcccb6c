"""What an agent knows of each container's health: state, restarts, faults, silence.

A control thread increments a heartbeat in the stats page, for which it needs the GIL.
When that stands still, the kernel's counters tell why: the process is stopped, a thread
holds the GIL, or it gets no CPU, which is reported only after a longer time.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from msgspec import Struct, structs

from poise.clock import wall_time
from poise.kernel_counters import Processes
from poise.runtime._calls import PageSampler
from poise.wire.records.status_records import ContainerHealth, ContainerState, Fault

_MOST_FAULTS = 100
_MOST_RESTARTS = 100
_LATELY = 60.0
"""Restarts within this time are counted as `restarts_lately` [s]."""

CHECK_EVERY = 0.2
"""The heartbeats are compared this often [s]."""
_SUSPICIOUS = 0.35
"""A heartbeat that stands still for longer than this is looked into [s]."""
_STARVED = 5.0
"""A container that gets no CPU for longer than this does not respond [s]."""
_LONG = 1.0
"""A container that used this much CPU time since its heartbeat is not starved [s]."""
_SHARE = 0.25
"""A thread that waits for a CPU for this share of a time is starved."""


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
        if known and known.state == "restarting" and known.reason:
            return  # there is no process yet
        if known and known.state == "stopped":  # its faults are of another session
            del self._of[container]
            known = None
        if known and known.state == "restarting":
            recent = self._restarts.setdefault(container, deque(maxlen=_MOST_RESTARTS))
            recent.append(self._clock())
            restarts = known.restarts + 1
            self._of[container] = structs.replace(known, restarts=restarts)
        self._enter(container, "starting")

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

    def forget_stopped(self) -> None:
        """Forget the containers of a robot that was stopped: another start follows."""
        self._of = {n: each for n, each in self._of.items() if each.state != "stopped"}

    def how_ended(self, container: str) -> str:
        """Return how a container ended that is not started again yet, for people."""
        known = self._of.get(container)
        if known is None or known.state != "restarting" or known.last_fault is None:
            return "ended"
        return known.last_fault.message

    def faults(self) -> tuple[Fault, ...]:
        """Return the latest faults, oldest first."""
        return tuple(self._faults)

    def records(self, usage: Usage) -> tuple[ContainerHealth, ...]:
        """Return the health of all containers, with what they use now."""
        since, records = self._clock() - _LATELY, []
        for name, health in self._of.items():
            used = structs.asdict(usage.get(name, _NOTHING))
            lately = sum(moment > since for moment in self._restarts.get(name, ()))
            records.append(structs.replace(health, **used, restarts_lately=lately))
        return tuple(records)

    def _enter(self, container: str, state: ContainerState, reason: str = "") -> None:
        known = self._of.get(container) or ContainerHealth(
            name=container, state=state, since=0.0
        )
        since = self._wall()
        self._of[container] = structs.replace(
            known, state=state, since=since, reason=reason
        )


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


class _Watched:
    """What is known of one container's heartbeat."""

    def __init__(self, beat: int, now: float, cpu: float) -> None:
        self.beat, self.since, self.cpu = beat, now, cpu
        self.looked_at = 0.0
        self.delays: dict[int, float] = {}
        self.silence: Silence | None = None


class Watchdog:
    """Compares heartbeats; `check` is called every `CHECK_EVERY`."""

    def __init__(
        self,
        processes: Processes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._processes = processes or Processes()
        self._clock = clock
        self._watched: dict[int, _Watched] = {}
        self._looked_at = 0.0

    def check(
        self, containers: Iterable[tuple[str, int, PageSampler]]
    ) -> Iterator[Silence]:
        """Yield the containers that do not respond any more, or do so again."""
        now = self._clock()
        # the watchdog itself got no CPU: nothing is known of that time
        was_away = now - self._looked_at > 2 * CHECK_EVERY
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
                silence = self._diagnosis(name, pid, known, now)
                if silence is not None:
                    known.silence = silence
                    yield silence
            self._watched[pid] = known

    def _diagnosis(
        self, name: str, pid: int, known: _Watched, now: float
    ) -> Silence | None:
        """Return why a container does not respond; None: it may yet."""
        seconds, kernel = now - known.since, self._processes
        if seconds < _SUSPICIOUS or kernel.has_ended(pid):
            return None  # the zygote reports its end
        silence = partial(
            Silence, container=name, pid=pid, seconds=seconds, heartbeat=known.beat
        )
        if kernel.is_stopped(pid):
            reason, remedy = _stop(pid, kernel.tracer(pid))
            return silence(reason=reason, remedy=remedy)
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
            return silence(reason="it gets no CPU", remedy=remedy, is_starved=True)
        else:
            reason = "a thread waits while it holds its interpreter (GIL)"
        remedy = f"`kill -KILL {pid}` ends it, and it is started again"
        return silence(reason=reason, remedy=remedy)


def _stop(pid: int, tracer: int) -> tuple[str, str]:
    """Return why a process is stopped, and what lets it go on."""
    if tracer:
        return f"process {tracer} debugs it", "Let it go on there"
    return "its process is stopped (SIGSTOP)", f"`kill -CONT {pid}` lets it go on"
