"""Components by which `poise calibrate` measures computers and connectors."""

from __future__ import annotations

import time

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
_PIECE = 0.05
_LOOP = 2_000


class Packet(Message, frozen=True):
    """A message of any size."""

    payload: bytes


class Echo:
    """A call with an answer."""

    def echo(self, packet: Packet) -> int:
        """Return the packet's size [bytes]."""
        raise NotImplementedError


class Yardstick(Component):
    """Does a fixed kind of work, and counts how much a CPU second does."""

    @every(4 * _PIECE)
    def work(self) -> None:
        """Measure ``score`` [loops per second of CPU time], and ``waited``.

        ``waited`` is the share of the time in which it was kept from running.
        """
        start = time.monotonic()
        began = now = time.thread_time()
        loops = 0
        while now - began < _PIECE:
            _loop()
            loops += 1
            now = time.thread_time()
        self.measure("score", loops / (now - began))
        self.measure("waited", 1 - (now - began) / (time.monotonic() - start))


class Echoer(Component):
    """Answers calls."""

    port: Provided[Echo]

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

    port: Required[Echo]

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


def _loop() -> int:
    """Do typical work of Python: arithmetic, calls, and memory accesses."""
    table = list(range(_LOOP))
    return sum(table[(7 * i) % _LOOP] ^ i for i in table)
