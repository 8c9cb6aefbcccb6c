"""What each handler of a component takes while that is profiled."""

from __future__ import annotations

import math
import os
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from poise.runtime._calls import Histogram
from poise.runtime.component.started_calls import StartedCalls
from poise.runtime.execution.counters import Counts
from poise.wire.records.status_records import Summary

_SHORT = 0.0005
"""A run that waits for less only waits for its turn [s]."""


class RunBegin(NamedTuple):
    """What was so when a run began: times, and what calls had taken so far [s]."""

    at: float
    cpu: float
    queued: float
    called: float
    cpu_of_called: float


class HandlerTimes:
    """CPU time of the runs of handlers, timers and calls, and for how long they wait.

    Those that they call count for themselves. A wait is what is left of a run beyond
    its CPU time, its calls and the time for which it waits for a CPU: for a device, a
    GPU, a lock. A call's run begins when it has entered the component.

    `ends`: returns the counts of the connectors over which it calls.
    `started`: the calls that it starts: on other threads, and it may go on meanwhile.
    """

    def __init__(
        self, ends: Callable[[], Iterable[Counts]], started: StartedCalls
    ) -> None:
        self._ends = ends
        self._started = started
        self._of_thread = threading.local()
        self._cpu: dict[str, Histogram] = {}
        self._waits: dict[str, Histogram] = {}

    def begin(self) -> RunBegin:
        """Return what is so as a run begins."""
        called, cpu_of_called = self._called()
        queued = self._queued()
        at, cpu = time.monotonic(), time.thread_time()
        return RunBegin(at, cpu, queued, called, cpu_of_called)

    def end(self, what: str, began: RunBegin) -> None:
        """Count a run that ends now."""
        cpu, at = time.thread_time(), time.monotonic()
        queued = self._queued()
        called, cpu_of_called = self._called()
        own = max(0.0, cpu - began.cpu - (cpu_of_called - began.cpu_of_called))
        self._cpu.setdefault(what, Histogram()).add(own)
        queued, called = queued - began.queued, called - began.called
        waited = at - began.at - own - called - queued
        if waited > _SHORT:  # never where the kernel does not count `queued`
            self._waits.setdefault(what, Histogram()).add(waited)

    def timing(self, method: Callable[..., Any], what: str) -> Callable[..., Any]:
        """Return a method whose runs are counted, unless they raise."""

        def timed(*args: object) -> Any:  # noqa: ANN401, the method's own
            began = self.begin()
            result = method(*args)
            self.end(what, began)
            return result

        return timed

    def cpu(self) -> Mapping[str, Summary]:
        """Return the CPU time of the runs of each [s]."""
        return {name: each.summary() for name, each in list(self._cpu.items())}

    def waits(self) -> Mapping[str, Summary]:
        """Return for how long the runs of each waited, those that did [s]."""
        return {name: each.summary() for name, each in list(self._waits.items())}

    def _queued(self) -> float:
        """Return how long the calling thread was ready so far and had no CPU [s]."""
        if not hasattr(self._of_thread, "queued"):
            self._of_thread.queued = _QueuedTime()
        queued: _QueuedTime = self._of_thread.queued
        return queued.read()

    def _called(self) -> tuple[float, float]:
        """Return how long its calls took so far, and their CPU on its threads [s]."""
        ends, beside = list(self._ends()), self._started.counts
        seconds = sum(end.delay.sum for end in ends) - beside.delay.sum
        cpu = sum(end.cpu for end in ends) - beside.cpu
        return seconds + self._started.awaited, cpu


class _QueuedTime:
    """For how long the thread that makes it was ready and had no CPU."""

    def __init__(self) -> None:
        self._file = -1
        try:
            flags = os.O_RDONLY | os.O_CLOEXEC
            self._file = os.open("/proc/thread-self/schedstat", flags)
        except OSError:  # the kernel does not count it
            return
        weakref.finalize(self, os.close, self._file)

    def read(self) -> float:
        """Return it so far [s]; no number where the kernel does not count it."""
        if self._file < 0:
            return math.nan
        return 1e-9 * int(os.pread(self._file, 100, 0).split()[1])
