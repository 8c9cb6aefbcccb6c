"""Reads the ledgers of a computer's containers and tells them, in one message."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from mmap import PAGESIZE
from pathlib import Path

import msgspec
from msgspec import Struct, structs

from poise.runtime._calls import Reader

log = logging.getLogger(__name__)

_SELDOM = 10
"""With every so many-th sample the memory of one container is read: that takes the
kernel a millisecond or two, more than all the rest. So it is only done when the
container holds more or less than before, and every `_ANYWAY`-th time: what it shares
with others may have changed."""
_ANYWAY = 10


class Sampler:
    """A thread of the agent; it wakes once per interval, however many containers.

    Parameters
    ----------
    computer
        Its name.
    every
        [s]; 0: only when asked by `sample`.
    containers
        Returns name, process number and ledger of the containers that run; called on
        the thread.
    publish
        Takes an encoded `poise.wire.records.samples.AgentSample`; called on the thread.
    """

    def __init__(
        self,
        computer: str,
        every: float,
        containers: Callable[[], Sequence[tuple[str, int, Reader]]],
        publish: Callable[[bytes], None],
    ) -> None:
        self._computer = computer
        self._every = every
        self._containers = containers
        self._publish = publish
        self._memory: dict[int, _Weight] = {}
        self._count = 0
        self._ended = threading.Event()
        self._encoder = msgspec.msgpack.Encoder()
        self._thread = threading.Thread(
            target=self._main, name="collector", daemon=True
        )

    def start(self) -> None:
        """Begin to collect; `every` is greater than 0."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; harmless when it never started."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def sample(self) -> bytes:
        """Return what is counted now, encoded."""
        containers = self._containers()
        self._weigh(containers)
        found = []
        for name, pid, reader in containers:
            read = reader.read()
            if read is not None:
                at, cpu, components, connectors = read
                memory = self._memory[pid].proportional
                found.append((name, pid, at, cpu, memory, components, connectors))
        now = time.monotonic()
        # an `AgentSample`, whose records are arrays
        return self._encoder.encode((self._computer, now, time.process_time(), found))

    def _main(self) -> None:
        while not self._ended.wait(self._every):
            try:
                self._publish(self.sample())
            except Exception:  # what is told next may go out again
                log.exception("a sample could not be told")

    def _weigh(self, containers: Sequence[tuple[str, int, Reader]]) -> None:
        """Read the memory of new containers, and of the others one after the other."""
        self._count = (self._count + 1) % max(1, len(containers) * _SELDOM)
        before, self._memory = self._memory, {}
        for place, (_, pid, reader) in enumerate(containers):
            known = before.get(pid)
            if known is None or self._count == place * _SELDOM:
                known = _weigh([pid, *reader.commands()], known)
            self._memory[pid] = known


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


def resident_memory(process: int) -> int:
    """Return what a process holds, shared or not [bytes]; 0 when it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_bytes().split()[1]) * PAGESIZE
    except OSError:
        return 0


def proportional_memory(process: int) -> int:
    """Return a process's proportional set size [bytes]; 0 when nobody tells."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_bytes()
    except OSError:
        return 0
    for line in text.splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0
