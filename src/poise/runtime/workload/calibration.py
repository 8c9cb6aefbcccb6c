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
"""Those who talk do so in steps, so many a second [1/s]."""
_PIECE = 0.05
_LOOP = 2_000


class Packet(Message, frozen=True):
    """A message of any size."""

    payload: bytes


class Echo:
    """A call that goes there and back."""

    def echo(self, packet: Packet) -> int:
        """Return the packet's size [bytes]."""
        raise NotImplementedError


class Yardstick(Component):
    """Does a fixed kind of work for a while, and counts how much a CPU second does."""

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
    """Does nothing in its steps: what a step costs by itself."""

    @every(1 / RATE)
    def tick(self) -> None:
        """Do nothing."""


class Asker(Component):
    """Calls once in each step, with ``size`` bytes."""

    port: Required[Echo]

    def configure(self) -> None:
        """Make what is sent."""
        self._packet = Packet(bytes(int(self.parameters["size"])))

    @every(1 / RATE)
    def ask(self) -> None:
        """Call."""
        self.port.echo(self._packet)


class Talker(Component):
    """Publishes once in each step, ``size`` bytes."""

    port: Published[Packet]

    def configure(self) -> None:
        """Make what is sent."""
        self._packet = Packet(bytes(int(self.parameters["size"])))

    @every(1 / RATE)
    def talk(self) -> None:
        """Publish."""
        self.port.publish(self._packet)


class Listener(Component):
    """Takes messages."""

    @subscribed(keep=4)
    def port(self, message: Packet) -> None:
        """Take one."""


def _loop() -> int:
    """Do what robots' Python does: arithmetic, calls, and memory here and there."""
    table = list(range(_LOOP))
    return sum(table[(7 * i) % _LOOP] ^ i for i in table)
