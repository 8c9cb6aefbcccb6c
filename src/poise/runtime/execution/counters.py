"""What is counted in a container, and the stats page that its agent reads it from.

The page is shared memory: threads add in place, and wake no process.
"""

from __future__ import annotations

import fcntl
import logging
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import TYPE_CHECKING

from poise.runtime import _calls
from poise.runtime._calls import ComponentCounters, Histogram, PageSampler
from poise.wire.records.deployment_records import ConnectorKind
from poise.wire.records.status_records import ConnectorStatus, Side, Summary

if TYPE_CHECKING:
    from poise.runtime.hosting.runner import Runner
    from poise.runtime.hosting.wiring import OpenConnector

log = logging.getLogger(__name__)
MOST = 8192
"""Components, timers, ends of connectors, and what calls a component from outside, that
fit; unused records take no memory."""
ComponentKey = tuple[str, int]
"""Name and epoch of a component."""


class Counts(_calls.Counts):
    """What one end of a connector counts, on the threads that use it."""

    refused = 0

    def refuse(self) -> None:
        """Count something that came and is not taken."""
        self.errors += 1
        self.refused += 1

    def status(
        self, name: str, key: str, kind: ConnectorKind, end: Side, *, ready: bool
    ) -> ConnectorStatus:
        """Return the numbers as a record."""
        return ConnectorStatus(
            name=name,
            key=key,
            kind=kind,
            end=end,
            ready=ready,
            calls=self.calls,
            messages=self.messages,
            bytes_out=self.bytes_out,
            bytes_in=self.bytes_in,
            errors=self.errors,
            refused=self.refused,
            drops=self.drops,
            delay=self.delay.summary(),
            wait=self.wait.summary(),
            size=self.size.summary(),
            latency=self.latency.summary(),
            latency_error=self.latency_error,
        )


class SignedHistogram:
    """Counts values of either sign, with quantiles right within 5 %."""

    def __init__(self) -> None:
        self._below, self._above = Histogram(), Histogram()
        self._maximum = -inf

    def add(self, value: float) -> None:
        """Count one value; what is no number (NaN) counts as 0."""
        (self._below if value < 0 else self._above).add(abs(value))
        self._maximum = max(self._maximum, value)

    def summary(self) -> Summary:
        """Return what is known of all values; mean and maximum are exact."""
        below, above = self._below.summary(), self._above.summary()
        if not below.count:
            return above
        count = below.count + above.count
        return Summary(
            count=count,
            mean=(above.count * above.mean - below.count * below.mean) / count,
            median=self._quantile(0.5, below.count, above.count),
            p99=self._quantile(0.99, below.count, above.count),
            maximum=self._maximum,
        )

    def _quantile(self, share: float, below: int, above: int) -> float:
        rank = share * (below + above)
        if rank <= below:
            return -self._below.quantile(1 - rank / below)
        return self._above.quantile((rank - below) / above)


def new_memory() -> int:
    """Return the descriptor of memory for one stats page of fixed size."""
    fd = os.memfd_create("stats_page", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(fd, MOST * _calls.RECORD_SIZE)
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
    return fd


def may_shrink(memory: int) -> bool:
    """Return whether who sent a descriptor could let its reader meet an end: SIGBUS."""
    try:
        seals = fcntl.fcntl(memory, fcntl.F_GET_SEALS)
    except OSError:  # a file, which has none
        return True
    return not seals & fcntl.F_SEAL_SHRINK


class StatsPage:
    """A container's end of its stats page."""

    def __init__(self, memory: int) -> None:
        self._native = _calls.StatsPage(memory)
        self._sampler = PageSampler(memory, os.getpid())
        self._shown: set[ComponentCounters | _calls.Counts] = set()
        self._refused: set[ComponentCounters | _calls.Counts] = set()

    def beat(self) -> None:
        """Show the agent that the calling thread runs; a few times a second."""
        self._native.beat()

    def show(
        self,
        running: Mapping[ComponentKey, Runner],
        connectors: Sequence[OpenConnector],
    ) -> None:
        """Let the agent see the counters of these, and of no others."""
        components = {key: runner.counters for key, runner in running.items()}
        beside = [*_over_no_connector(running.values())]
        wanted: set[ComponentCounters | _calls.Counts] = {*components.values()}
        wanted |= {counts for _, counts, _ in beside}
        wanted |= {connector.counts for connector in connectors}
        for removed in self._shown - wanted:
            removed.leave()
        new, self._shown = wanted - self._shown, wanted
        self._refused &= wanted
        for (name, epoch), counters in components.items():
            if counters in new and not counters.enter(self._native, name, epoch):
                self._refuse(counters, f"component '{name}'")
        for runner, counts, what in beside:
            if counts in new and not counts.enter(self._native, ""):
                self._refuse(counts, what.format(runner.spec.name))
            counts.attribute(None, runner.counters)
        for connector in connectors:
            spec, counts = connector.spec, connector.counts
            if counts in new and not counts.enter(self._native, spec.name):
                self._refuse(counts, f"connector {spec.name}")
            # during a move a sender has two routes: the later one is the one it uses
            counts.attribute(
                components.get((spec.source, spec.source_epoch)),
                components.get((spec.target, spec.target_epoch)),
            )

    def cpu(self) -> tuple[float, dict[ComponentKey, float]]:
        """Return the CPU time of the container, and of each component, so far [s]."""
        reading = self._sampler.read()
        if reading is None:  # no component is entered
            return time.process_time(), {}
        return reading[1], {(c[0], c[1]): c[2] for c in reading[2]}

    def _refuse(self, counters: ComponentCounters | _calls.Counts, what: str) -> None:
        self._shown.discard(counters)  # there may be room the next time
        if counters not in self._refused:
            self._refused.add(counters)
            log.warning("%s is not counted: all %d records are in use", what, MOST)


def _over_no_connector(
    runners: Iterable[Runner],
) -> Iterator[tuple[Runner, _calls.Counts, str]]:
    """Yield whose calls and callers are counted beside connectors, and as what."""
    for runner in runners:
        kinds = {port.kind for port in runner.ports.values()}
        if "provides" in kinds:
            yield runner, runner.outside_calls, "what calls '{}' from outside"
        if "requires" in kinds:
            yield runner, runner.started.counts, "what '{}' starts to call"
