"""Samples the stats pages of a computer's containers and watches their heartbeats.

A leak grows all the time: memory counts as growing when it grows from each fifth of a
time to the next, and beyond all that it was within the minute before.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import combinations, pairwise
from statistics import mean, median

import msgspec
from msgspec import Struct, structs

from poise import threads
from poise.kernel_counters import (
    ComputerCpu,
    ComputerMemory,
    private_memory,
    proportional_memory,
    resident_memory,
)
from poise.runtime._calls import PageSampler
from poise.runtime.supervision.health import (
    CHECK_EVERY,
    ContainerUse,
    Silence,
    Usage,
    Watchdog,
)

log = logging.getLogger(__name__)

_SELDOM = 25
"""Every 25th sample reads the memory of one container, which takes the kernel a
millisecond or two, more than all the rest. It is skipped while the container's resident
memory stays the same, but not more than `_ANYWAY` times: what it shares with others may
have changed."""
_ANYWAY = 10
_COMPARED = 5
"""Every fifth sample looks whether one has grown."""
_GROWN = 1.1
"""One container whose resident memory grew by this factor is read then."""


USAGE_EVERY = 1.0
"""CPU use is the mean over at least this time [s]."""
_AGENT = ""
"""The name under which the agent's own use is kept."""

READ_EVERY = 1.0
"""Memory is read this often [s]."""
_FIFTH = 3
"""Readings in each fifth of the time that is looked at."""
_ALL = 5 * _FIFTH
_COARSE = 4
"""What grows in lumps is seen over a longer time, with every fourth reading."""
_CONFIRMED = 3
"""It begins to grow, or ceases, when as many readings in succession say so."""
_PART = 0.6
"""From each fifth to the next it grows by at least this part of the mean growth."""
_BEFORE = 60.0
"""It must exceed all that it was within this time before [s]."""
_LEAST = 64 * 1024.0
"""Slower growth is none [bytes/s]."""


class Sampler:
    """A thread of the agent; it wakes once per interval, however many containers."""

    def __init__(
        self,
        computer: str,
        every: float,
        containers: Callable[[], Sequence[tuple[str, int, PageSampler]]],
        publish: Callable[[bytes], None],
        on_silence: Callable[[Silence], None],
    ) -> None:
        self._computer = computer
        self._every = every
        self._containers = containers
        self._publish = publish
        self._on_silence = on_silence
        self._watchdog = Watchdog()
        self._memory: dict[int, _Weight] = {}
        self._own_memory: _Weight | None = None
        self._growth: dict[int, MemoryGrowth] = {}
        self._computer_cpu = ComputerCpu()
        self._computer_memory = ComputerMemory()
        self._count = 0
        self._rates: dict[str, _Rate] = {}
        self._usage: Usage = {}
        self._ended = threading.Event()
        self._encoder = msgspec.msgpack.Encoder()
        self._thread = threads.daemon(self._main, "sampler", again=True)

    def start(self) -> None:
        """Begin to sample and to watch."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; harmless when it never started."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def usage(self) -> Usage:
        """Return what the agent (an empty name) and each container use; any thread."""
        return self._usage

    def sample(self) -> bytes:
        """Return what is counted now, encoded."""
        containers = self._containers()
        self._weigh(containers)
        growth = self._follow_growth(containers, time.monotonic())
        samples = []
        for name, pid, page in containers:
            read = page.read()
            if read is not None:
                at, cpu, components, connectors = read
                memory = self._memory[pid].proportional
                samples.append((name, pid, at, cpu, memory, components, connectors))
        now, own = time.monotonic(), time.process_time()
        used = {n: (cpu, memory) for n, _, _, cpu, memory, *_ in samples}
        self._note_usage(now, own, used, growth)
        # an `AgentSample`, whose records are arrays
        sample = (self._computer, now, own, samples, self._computer_cpu.read())
        return self._encoder.encode(sample)

    def _follow_growth(
        self, containers: Sequence[tuple[str, int, PageSampler]], now: float
    ) -> dict[str, float]:
        """Return how fast the memory of each container grows [bytes/s]."""
        before, self._growth = self._growth, {}
        for _, pid, page in containers:
            growth = self._growth[pid] = before.get(pid) or MemoryGrowth()
            if growth.is_due(now):
                size = sum(map(private_memory, [pid, *page.descendants()]))
                growth.update(now, size)
        return {name: self._growth[pid].rate for name, pid, _ in containers}

    def _note_usage(
        self,
        now: float,
        own: float,
        containers: dict[str, tuple[float, int]],
        growth: dict[str, float],
    ) -> None:
        before, self._rates = self._rates, {}
        if self._count % _SELDOM == 0:
            self._own_memory = _weigh([os.getpid()], self._own_memory)
        agent = own, self._own_memory.proportional if self._own_memory else 0
        for name, (cpu, size) in {_AGENT: agent, **containers}.items():
            self._rates[name] = _Rate.next(before.get(name), now, cpu, size)
        total = sum(growth.values())
        room = self._computer_memory.read() if total else None
        usage = {}
        for name, rate in self._rates.items():
            use, grows = ContainerUse(rate.cores, rate.memory), growth.get(name, 0.0)
            if grows and room is not None:
                limit, full_in = room.limit, room.free / total
                use = structs.replace(use, growth=grows, limit=limit, full_in=full_in)
            usage[name] = use
        self._usage = usage

    def _main(self) -> None:
        period = min(self._every or CHECK_EVERY, CHECK_EVERY)
        sample_at = usage_at = time.monotonic()
        while not self._ended.wait(period):
            for silence in self._watchdog.check(self._containers()):
                self._on_silence(silence)
            now = time.monotonic()
            is_due = bool(self._every) and now >= sample_at
            if is_due or now >= usage_at:
                sample, usage_at = self.sample(), now + USAGE_EVERY
            if is_due:
                sample_at = max(sample_at + self._every, now)
                self._publish(sample)

    def _weigh(self, containers: Sequence[tuple[str, int, PageSampler]]) -> None:
        """Read the memory of new and grown containers; of others one after another."""
        self._count = (self._count + 1) % max(1, len(containers) * _SELDOM)
        before, self._memory = self._memory, {}
        one_grew = self._count % _COMPARED != 0  # or it does not matter now
        for place, (_, pid, page) in enumerate(containers):
            known, is_due = before.get(pid), self._count == place * _SELDOM
            if known is None or is_due or not one_grew:
                processes = [pid, *page.descendants()]
                resident = sum(map(resident_memory, processes))
                has_grown = known is not None and resident > _GROWN * known.resident
                one_grew = one_grew or has_grown
                if known is None or is_due or has_grown:
                    known = _weigh(processes, known)
            self._memory[pid] = known


class _Rate(Struct, frozen=True):
    """CPU use [cores] since the moment before `at` [s], and memory use [bytes]."""

    at: float
    cpu: float
    cores: float
    memory: int

    @classmethod
    def next(cls, known: _Rate | None, now: float, cpu: float, memory: int) -> _Rate:
        """Return the use at `now` [s], when `cpu` [s] was used in all."""
        if known is None or cpu < known.cpu:
            return cls(now, cpu, 0.0, memory)
        if now - known.at < USAGE_EVERY:
            return cls(known.at, known.cpu, known.cores, memory)
        return cls(now, cpu, (cpu - known.cpu) / (now - known.at), memory)


class _Weight(Struct, frozen=True):
    """What processes held together [bytes], and how often that was taken for true."""

    resident: int
    proportional: int
    age: int = 0


def _weigh(processes: Sequence[int], known: _Weight | None) -> _Weight:
    resident = sum(map(resident_memory, processes))
    if known and known.resident == resident and known.age < _ANYWAY:
        return structs.replace(known, age=known.age + 1)
    return _Weight(resident, sum(map(proportional_memory, processes)))


class MemoryGrowth:
    """Follows the memory of one container."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._read_at = float("-inf")
        self._count = self._unlike = 0
        self._fine, self._coarse = _Trend(READ_EVERY), _Trend(_COARSE * READ_EVERY)

    def is_due(self, now: float) -> bool:
        """Return whether the memory should be read at `now` [s]."""
        return now - self._read_at >= READ_EVERY

    def update(self, now: float, size: float) -> None:
        """Add a reading [bytes] that was due at `now` [s]."""
        self._read_at = now
        self._fine.add(now, size)
        if self._count % _COARSE == 0:
            self._coarse.add(now, size)
        self._count += 1
        rate = self._fine.rate() or self._coarse.rate()
        self._unlike = 0 if bool(rate) == bool(self.rate) else self._unlike + 1
        if self._unlike == 0 or self._unlike >= _CONFIRMED:
            self.rate, self._unlike = rate, 0


class _Trend:
    """The last readings, one each `every` seconds."""

    def __init__(self, every: float) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=_ALL)
        self._before: deque[float] = deque(maxlen=round(_BEFORE / every))

    def add(self, now: float, size: float) -> None:
        if len(self._last) == _ALL:
            self._before.append(self._last[0][1])
        self._last.append((now, size))

    def rate(self) -> float:
        """Return the growth [bytes/s]: the median of the slopes of all pairs."""
        if len(self._last) < _ALL:
            return 0.0
        readings = list(self._last)
        if not _grows([size for _, size in readings], max(self._before, default=0.0)):
            return 0.0
        pairs = combinations(readings, 2)
        rate = median((b - a) / (later - at) for (at, a), (later, b) in pairs)
        return rate if rate >= _LEAST else 0.0


def _grows(sizes: Sequence[float], highest: float) -> bool:
    """Return whether each fifth is higher than the one before, and than `highest`."""
    starts = range(0, len(sizes), _FIFTH)
    levels = [median(sizes[at : at + _FIFTH]) for at in starts]
    steps = [after - before for before, after in pairwise(levels)]
    steady = min(steps) > 0 and min(steps) >= _PART * mean(steps)
    return steady and levels[-1] > highest
