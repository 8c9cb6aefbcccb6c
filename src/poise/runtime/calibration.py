"""Components by which `poise calibrate` measures computers and connectors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import cycle

from poise.runtime.component.component import Component
from poise.runtime.component.ports import (
    Message,
    Provided,
    Published,
    Required,
    every,
    subscribed,
)

RATE = 50.0
"""Rate of calls and messages [1/s]."""
SCORES = ("score_0", "score_1", "score_2", "score_3")
"""Series of measurements, in turn: their largest values agree, or are discarded."""
_PIECE = 0.05
_LOOP = 2_000


class Packet(Message, frozen=True):
    """A message of any size."""

    payload: bytes


class EchoCall:
    """A call with an answer."""

    def echo(self, packet: Packet) -> int:
        """Return the packet's size [bytes]."""
        raise NotImplementedError


def score() -> float:
    """Return how much work of a fixed kind a CPU second does here [loops/s].

    Other processes make loops slower, by the caches and cores that they share, but
    seldom all of them: the quickest tenth counts, without the one that was lucky.
    """
    times = sorted(_loop_times(time.thread_time() + _PIECE))
    return 1 / times[len(times) // 10]


class Yardstick(Component):
    """Measures how much work a CPU second does."""

    def configure(self) -> None:
        """Begin with the first series."""
        self._series = cycle(SCORES)

    @every(4 * _PIECE)
    def work(self) -> None:
        """Measure the next of `SCORES` [loops/s]."""
        self.measure(next(self._series), score())


class Echoer(Component):
    """Answers calls."""

    port: Provided[EchoCall]

    def echo(self, packet: Packet) -> int:
        """Return the packet's size [bytes]."""
        return len(packet.payload)


class Ticker(Component):
    """Has an empty timer, to measure the cost of a timer."""

    @every(1 / RATE)
    def tick(self) -> None:
        """Do nothing."""


class _Sized(Component):
    """Has a packet of ``size`` bytes."""

    def configure(self) -> None:
        """Make the packet."""
        self._packet = Packet(bytes(int(self.parameters["size"])))


class Asker(_Sized):
    """Calls once in each step."""

    port: Required[EchoCall]

    @every(1 / RATE)
    def ask(self) -> None:
        """Call."""
        self.port.echo(self._packet)


class Talker(_Sized):
    """Publishes once in each step."""

    port: Published[Packet]

    @every(1 / RATE)
    def talk(self) -> None:
        """Publish."""
        self.port.publish(self._packet)


class Listener(Component):
    """Receives messages."""

    @subscribed(keep=4)
    def port(self, message: Packet) -> None:
        """Ignore it."""


def _loop_times(end: float) -> Iterator[float]:
    """Yield the CPU times of loops until the thread's CPU time is `end` [s]."""
    began = time.thread_time()
    while began < end:
        _loop()
        now = time.thread_time()
        yield now - began
        began = now


def _loop() -> int:
    """Do typical work of Python: arithmetic, calls, and memory accesses."""
    table = list(range(_LOOP))
    return sum(table[(7 * i) % _LOOP] ^ i for i in table)
