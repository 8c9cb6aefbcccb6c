"""Poise's side: components in two containers, joined by its own wiring.

Both processes do what a container does with what its agent tells it.

It imports internal modules: it measures connectors without a manager or an agent.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.calls.ping import Ping
from benchmarks.calls.timing import BIG, Trips, payload, read, timed
from poise.clock import SystemClock
from poise.runtime.component.component import Component
from poise.runtime.component.ports import (
    Message,
    Provided,
    Published,
    Required,
    subscribed,
)
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Wiring
from poise.wire.connections.blocks import loan
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.connections.gateway import Gateway
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ConnectorKind,
    ConnectorSpec,
)

HOST, PORT = "127.0.0.1", 17448
LIMIT = 30.0
"""Far above what a call takes on a machine that others use, too [s]."""


class Echo:
    """The interface of the calls."""

    def echo(self, data: bytes) -> bytes:
        """Return what came."""
        raise NotImplementedError

    def echo_array(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return what came."""
        raise NotImplementedError

    def echo_loan(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a loan that holds what came."""
        raise NotImplementedError


class Small(Message):
    """A message without an array."""

    data: bytes


class Big(Message):
    """A message with an array."""

    data: NDArray[np.uint8]


class Callee(Component):
    """Sends back what comes."""

    calls: Provided[Echo]
    small_pong: Published[Small]
    big_pong: Published[Big]

    def echo(self, data: bytes) -> bytes:
        """Return what came."""
        return data

    def echo_array(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return what came."""
        return data

    def echo_loan(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a loan that holds what came."""
        return filled(data)

    @subscribed(keep=4)
    def small_ping(self, message: Small) -> None:
        """Send it back."""
        self.small_pong.publish(message)

    @subscribed(keep=4)
    def big_ping(self, message: Big) -> None:
        """Send it back."""
        self.big_pong.publish(message)


class Caller(Component):
    """Asks and measures."""

    calls: Required[Echo]
    small_ping: Published[Small]
    big_ping: Published[Big]

    def configure(self) -> None:
        """Have nobody to tell yet."""
        self.on_pong: Callable[[], None] = lambda: None

    @subscribed(keep=4)
    def small_pong(self, message: Small) -> None:
        """Take an answer."""
        del message
        self.on_pong()

    @subscribed(keep=4)
    def big_pong(self, message: Big) -> None:
        """Take an answer."""
        read(message.data)
        del message
        self.on_pong()


def filled(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a loan that holds `data`."""
    made = loan(data.shape, np.uint8)
    made[:] = data
    return made


def array(size: int) -> NDArray[np.uint8]:
    """Return a payload as an array."""
    return np.frombuffer(bytearray(payload(size)), np.uint8)


def connectors(
    kind: ConnectorKind, *, only_calls: bool = False
) -> tuple[ConnectorSpec, ...]:
    """Return the calls' connector and the topics', there and back."""
    ports = (
        ("caller", "calls", "callee", "calls"),
        ("caller", "small_ping", "callee", "small_ping"),
        ("caller", "big_ping", "callee", "big_ping"),
        ("callee", "small_pong", "caller", "small_pong"),
        ("callee", "big_pong", "caller", "big_pong"),
    )
    return tuple(
        ConnectorSpec(
            name=port,
            kind=kind,
            source=source,
            source_port=port,
            target=target,
            target_port=target_port,
            address=f"{HOST}:{PORT}/{target}" if kind == "remote" else target,
            limit=LIMIT,
        )
        for source, port, target, target_port in ports[: 1 if only_calls else None]
    )


def start(name: str, implementation: type[Component]) -> Runner:
    """Return a component at work, still without connectors."""
    spec = ComponentSpec(goal="active", name=name, implementation="")
    return Runner(spec, implementation, SystemClock(), lambda: None)


def activate(runner: Runner) -> None:
    """Start a component and wait until it works."""
    runner.start()
    runner.aim("active")
    end = time.monotonic() + 10
    while runner.life_cycle.state != "active":
        assert time.monotonic() < end, runner.status().error
        time.sleep(0.005)


def serve(
    kind: ConnectorKind,
    folder: Path,
    ready: Callable[[], None],
    callee: type[Component] = Callee,
) -> None:
    """Run the callee in a container of its own."""
    gateway = Gateway(folder, HOST, PORT) if kind == "remote" else None
    runner = start("callee", callee)
    wiring = Wiring(ConnectionServer(folder, "callee"))
    specs = connectors(kind, only_calls=callee is not Callee)
    wiring.apply(specs, {("callee", 0): runner})
    activate(runner)
    ready()
    threading.Event().wait()
    del gateway


@contextmanager
def connect(
    kind: ConnectorKind,
    folder: Path,
    caller: type[Component] = Caller,
    callee: type[Component] = Callee,
) -> Iterator[Runner]:
    """Run the caller in a container of its own, or in one with the callee."""
    runners = {("caller", 0): start("caller", caller)}
    if kind == "direct":
        runners["callee", 0] = start("callee", callee)
    wiring = Wiring(ConnectionServer(folder, "caller"))
    only_calls = (caller, callee) != (Caller, Callee)
    wiring.apply(connectors(kind, only_calls=only_calls), runners)
    for runner in runners.values():
        activate(runner)
    end = time.monotonic() + 10
    while not all(connector.ready for connector in wiring.status()):
        assert time.monotonic() < end, "the callee was not found"
        time.sleep(0.01)
    yield runners["caller", 0]


@contextmanager
def calls(kind: ConnectorKind, folder: Path) -> Iterator[Trips]:
    """Give the round trips of calls."""
    with connect(kind, folder) as runner:
        caller = runner.component
        assert isinstance(caller, Caller)

        def trips(size: int, count: int) -> list[float]:
            if size < BIG:
                return timed(caller.calls.echo, payload(size), count)
            echo = caller.calls.echo_array
            return timed(lambda data: read(echo(data)), array(size), count)

        yield trips


@contextmanager
def loans(folder: Path) -> Iterator[Trips]:
    """Give the round trips of calls with a new loan there and a new one back.

    Both are filled, as others fill what they send.
    """
    with connect("local", folder) as runner:
        caller = runner.component
        assert isinstance(caller, Caller)
        echo = caller.calls.echo_loan

        def trips(size: int, count: int) -> list[float]:
            return timed(lambda data: read(echo(filled(data))), array(size), count)

        yield trips


@contextmanager
def topics(kind: ConnectorKind, folder: Path) -> Iterator[Trips]:
    """Give the round trips of messages."""
    with connect(kind, folder) as runner:
        caller = runner.component
        assert isinstance(caller, Caller)
        small, big = Ping(caller.small_ping.publish), Ping(caller.big_ping.publish)

        def trips(size: int, count: int) -> list[float]:
            ping = small if size < BIG else big
            caller.on_pong = ping.on_pong
            if size < BIG:
                return ping.trips(Small(payload(size)), count)
            return ping.trips(Big(array(size)), count)

        yield trips
