"""A component that uses the CPU, memory and traffic that its parameters declare."""

from __future__ import annotations

import time
from typing import Any

from poise import Component, Message, Provided, Published, Required, every, subscribed

RATE = 20.0
_CHUNK = 200


class Block(Message, frozen=True):
    """A message of any size."""

    payload: bytes


class Work:
    """What a server does for its caller."""

    def work(self, size: int) -> int:
        """Use the callee's CPU time."""
        raise NotImplementedError


def burn(seconds: float) -> None:
    """Use so much CPU time of this thread [s], to some 10 us."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        sum(range(_CHUNK))


class Worker(Component):
    """Uses `cpu` [cores] in jobs at `RATE`, holds `memory` [bytes].

    At `dearer_at` [s] after activation its jobs cost half as much again.
    """

    def configure(self) -> None:
        self._job = float(self.parameters["cpu"]) / RATE
        # every page is written, so that it is there
        self._held = bytearray(b"x") * int(self.parameters.get("memory", 0))
        self._dearer_at = float(self.parameters.get("dearer_at", "inf"))

    def activate(self) -> None:
        self._began = self.clock.now()

    @every(1 / RATE, deadline=1 / RATE)
    def cycle(self) -> None:
        if self._began + self._dearer_at <= self.clock.now():
            self.measure("dearer", self.clock.now())
            self._dearer_at = float("inf")
            self._job *= 1.5
        burn(self._job)


class Server(Component):
    """Does its work when it is called, on its caller's thread."""

    work_port: Provided[Work]

    def configure(self) -> None:
        self._job = float(self.parameters["cpu"]) / RATE

    def work(self, size: int) -> int:
        burn(self._job)
        return size


class Caller(Component):
    """Calls a server at `RATE`, then works itself, then publishes `size` bytes."""

    server: Required[Work]
    blocks: Published[Block]

    def configure(self) -> None:
        self._job = float(self.parameters["cpu"]) / RATE
        self._payload = bytes(int(self.parameters["size"]))

    @every(1 / RATE, deadline=1 / RATE)
    def cycle(self) -> None:
        self.server.work(1)
        burn(self._job)
        self.blocks.publish(Block(self._payload))


class Sink(Component):
    """Works for every message."""

    def configure(self) -> None:
        self._job = float(self.parameters["cpu"]) / RATE
        self._last: Any = None

    @subscribed(keep=4)
    def blocks(self, message: Block) -> None:
        self._last = message
        burn(self._job)


class Light(Component):
    """Does next to nothing, five times a second."""

    @every(0.2)
    def cycle(self) -> None:
        """Only be there."""


class Silent(Component):
    """Does nothing at all."""
