"""A cable between two computers is cut, and mended: both ends notice, and go on."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.emulate import EmulatedComputer, Emulation, probe_host
from poise.errors import CallError, Unavailable
from poise.model.robot import Computer, Robot
from poise.wire.address import LOST_AFTER, Address
from poise.wire.connections.channel import Channel
from poise.wire.connections.connection import Connection
from tests.waiting import LIMIT, wait_until

from .conftest import TEXT, call, message

SERVE = """
import pathlib, sys, threading
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.connection import current_connection
from poise.wire.connections.gateway import Gateway
from poise.wire.frame import FrameKind
from poise.wire.connections.connection_server import ConnectionServer

TEXT = codec(str)

def handle(received):
    text = received.value(TEXT)
    if received.kind is FrameKind.CALL:
        return frame.segments(TEXT, text[::-1], FrameKind.RESULT)
    print(text, flush=True)
    if text == "later":
        pieces = frame.segments(TEXT, text, FrameKind.CREDIT)
        threading.Timer(1.5, current_connection().send_back, [pieces]).start()

folder = pathlib.Path(sys.argv[1])
server = ConnectionServer(folder, "there")
server.open("echo", handle)
with Gateway(folder, sys.argv[2]) as gateway:
    print(gateway, flush=True)
    while not server._connections:
        threading.Event().wait(0.01)
    while server._connections:
        threading.Event().wait(0.01)
    print("alone", flush=True)
    threading.Event().wait()
"""

pytestmark = pytest.mark.slow


class There:
    """Another computer, at the end of a cable."""

    def __init__(self, computer: EmulatedComputer) -> None:
        self._computer = computer
        argv = [sys.executable, "-c", SERVE, str(computer.folder), computer.address]
        self._server = computer.popen(argv, stdout=subprocess.PIPE)
        self.gateway = self.line()

    def line(self) -> str:
        assert self._server.stdout is not None
        return self._server.stdout.readline().decode().strip()

    def set_cable(self, state: str) -> None:
        argv = ["ip", "link", "set", "eth0", state]
        assert self._computer.popen(argv).wait(LIMIT) == 0

    def close(self) -> None:
        self._server.kill()
        self._server.communicate(timeout=LIMIT)


@pytest.fixture
def there(tmp_path: Path) -> Iterator[There]:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    computer = Computer(name="far", capacity={"cpu": 0.5, "memory": 512e6})
    robot = Robot(name="cable", computers=(computer,))
    with Emulation(robot, tmp_path) as emulation:
        there = There(emulation.computers["far"])
        yield there
        there.close()


@pytest.fixture
def channel(there: There, tmp_path: Path) -> Iterator[Channel]:
    channel = Channel("echo", Address.parse(f"{there.gateway}/there"), tmp_path)
    yield channel
    channel.close()


def test_a_cut_cable_is_noticed_at_both_ends_and_its_mending_too(
    there: There, channel: Channel
) -> None:
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
    channel.push(message("first"), LIMIT)
    assert there.line() == "first"
    there.set_cable("down")
    began = time.monotonic()
    with pytest.raises(Unavailable):
        channel.request(call("lost"), 100.0)
    assert time.monotonic() - began > LOST_AFTER / 2  # a short cut would do no harm
    wait_until(lambda: not channel.try_connect())
    assert there.line() == "alone"
    began = time.monotonic()
    for _ in range(100):  # whoever publishes is not held up each time
        with pytest.raises(CallError):
            channel.push(message("lost"), LIMIT)
    assert time.monotonic() - began < 2 * LIMIT
    there.set_cable("up")
    wait_until(channel.try_connect)
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
    channel.push(message("last"), LIMIT)
    assert there.line() == "last"


def test_what_is_sent_while_a_cable_is_cut_for_a_moment_arrives(
    there: There, channel: Channel
) -> None:
    channel.push(message("first"), LIMIT)
    assert there.line() == "first"
    there.set_cable("down")
    channel.push(message("second"), LIMIT)
    there.set_cable("up")
    assert there.line() == "second"


def test_a_connection_goes_on_after_the_third_retransmission_in_vain(
    there: There, channel: Channel
) -> None:
    """The fourth one comes when a lost computer would be given up in 3 s."""
    channel.push(message("first"), LIMIT)
    assert there.line() == "first"
    (connection,) = channel._messages
    there.set_cable("down")
    channel.push(message("second"), LIMIT)
    wait_until(lambda: retransmissions(connection) == 3)
    there.set_cable("up")
    while connection.is_idle() and retransmissions(connection):
        time.sleep(0.01)
    channel.push(message("third"), LIMIT)
    assert [there.line(), there.line()] == ["second", "third"]
    assert [*channel._messages] == [connection]


def retransmissions(connection: Connection) -> int:
    """Return how often TCP has sent again, in vain, what waits to be acknowledged."""
    info = connection._connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 3)
    return info[2]


def test_who_only_receives_notices_that_its_credit_reaches_nobody(
    there: There, channel: Channel
) -> None:
    channel.push(message("later"), LIMIT)
    assert there.line() == "later"
    there.set_cable("down")
    began = time.monotonic()
    assert there.line() == "alone"
    assert time.monotonic() - began < LIMIT
