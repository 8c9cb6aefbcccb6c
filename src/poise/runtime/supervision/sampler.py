"""Samples the stats pages of a computer's containers and watches their heartbeats.

A leak grows all the time: memory counts as growing when it grows from each fifth of a
time to the next, and beyond all that it was within the minute before.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, pairwise
from statistics import mean, median

import msgspec
from msgspec import structs

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

_AGENT = ""
"""The name under which the agent's own use is kept."""
READ_EVERY = 1.0
"""Memory and CPU use are looked at this often [s]."""
_ANYWAY = 10
"""A container whose resident memory stays the same is weighed each tenth time that it
is its turn: what it shares with others may have changed."""
_TURNS_EVERY = 5
"""At every fifth look it is the next one's turn: to weigh takes the kernel a
millisecond or two, more than all the rest."""
_GROWN = 1.1
"""What has grown by this factor is weighed at once."""
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
        self._memory: dict[int, _Memory] = {}
        self._num_looks = 0
        self._look_at = 0.0
        self._looked_at = float("-inf")
        self._computer_cpu = ComputerCpu()
        self._computer_memory = ComputerMemory()
        self._cpu: dict[str, float] = {}
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

    def sample(self, now: float) -> bytes:
        """Return what is counted at `now` [s], encoded."""
        containers = self._containers()
        reads = [(name, pid, page.read()) for name, pid, page in containers]
        own, busy = time.process_time(), self._computer_cpu.read()
        is_look = now >= self._look_at
        # not before what belongs to that moment: it takes a while
        self._read_memory(containers, now, is_look=is_look)
        samples = []
        for name, pid, read in reads:
            if read is not None:
                at, cpu, components, connectors = read
                memory = self._memory[pid].proportional
                samples.append((name, pid, at, cpu, memory, components, connectors))
        if is_look:
            used = {name: (pid, cpu) for name, pid, _, cpu, *_ in samples}
            self._note_usage(now, {_AGENT: (os.getpid(), own), **used})
            self._look_at, self._looked_at = now + READ_EVERY, now
        # an `AgentSample`, whose records are arrays
        sample = (self._computer, now, own, samples, busy)
        return self._encoder.encode(sample)

    def _read_memory(
        self,
        containers: Sequence[tuple[str, int, PageSampler]],
        now: float,
        *,
        is_look: bool,
    ) -> None:
        """Read the memory of new containers, and at a look that of all."""
        before, self._memory = self._memory, {}
        self._num_looks += is_look
        turn, rest = divmod(self._num_looks, _TURNS_EVERY)
        pages = {os.getpid(): None} | {pid: page for _, pid, page in containers}
        for place, (pid, page) in enumerate(pages.items()):
            memory = self._memory[pid] = before.get(pid) or _Memory()
            if is_look or pid not in before:
                processes = [pid, *(page.descendants() if page else ())]
                is_turn = rest == 0 and turn % len(pages) == place
                memory.read(now, processes, is_turn=is_turn)

    def _note_usage(self, now: float, used: Mapping[str, tuple[int, float]]) -> None:
        """Note what each holds, and used since the look before.

        `used`: name -> process and its CPU time so far [s].
        """
        memory = {name: self._memory[pid] for name, (pid, _) in used.items()}
        total = sum(each.growth.rate for each in memory.values())
        room = self._computer_memory.read() if total else None
        before, self._cpu = self._cpu, {name: cpu for name, (_, cpu) in used.items()}
        usage = {}
        for name, cpu in self._cpu.items():
            held, cores = memory[name], max(0.0, cpu - before.get(name, cpu))
            use = ContainerUse(cores / (now - self._looked_at), held.proportional)
            if room is not None and (growth := held.growth.rate):
                limit, full_in = room.limit, room.free / total
                use = structs.replace(use, growth=growth, limit=limit, full_in=full_in)
            usage[name] = use
        self._usage = usage

    def _main(self) -> None:
        period = min(self._every or CHECK_EVERY, CHECK_EVERY)
        sample_at = time.monotonic()
        while not self._ended.wait(period):
            for silence in self._watchdog.check(self._containers()):
                self._on_silence(silence)
            now = time.monotonic()
            is_due = bool(self._every) and now >= sample_at
            if is_due or now >= self._look_at:
                sample = self.sample(now)
            if is_due:
                sample_at = max(sample_at + self._every, now)
                self._publish(sample)


class _Memory:
    """What the processes of a container hold together [bytes]."""

    def __init__(self) -> None:
        self.proportional = 0
        self.growth = MemoryGrowth()
        self._resident = self._num_turns = 0

    def read(self, now: float, processes: Sequence[int], *, is_turn: bool) -> None:
        """Follow its growth, and weigh it if it changed, or has not been for long."""
        self.growth.update(now, sum(map(private_memory, processes)))
        resident = sum(map(resident_memory, processes))
        self._num_turns += is_turn
        has_changed = resident != self._resident or self._num_turns >= _ANYWAY
        if resident > _GROWN * self._resident or (is_turn and has_changed):
            self.proportional = sum(map(proportional_memory, processes))
            self._resident, self._num_turns = resident, 0


class MemoryGrowth:
    """Follows the memory of one container."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._count = self._unlike = 0
        self._fine, self._coarse = _Trend(READ_EVERY), _Trend(_COARSE * READ_EVERY)

    def update(self, now: float, size: float) -> None:
        """Add a reading [bytes], which comes every `READ_EVERY`."""
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
