"""A receiver is told of a block before all is in it, and never sees it too early."""

from __future__ import annotations

import itertools
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from poise.errors import Timeout, Unavailable
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections import shared_memory
from poise.wire.connections.connection import Connection
from poise.wire.frame import LARGEST, Frame, Kind
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

ANY = codec(Any)
LONG = 20.0
SIZE = 1 << 20
LENT, BEING_FILLED, AWAITED = 1, 2, 3


class Endpoints:
    """A sender that has told of a block which it does not fill, and its receiver."""

    def __init__(self) -> None:
        self.sender, self.receiver = map(Connection, socket.socketpair())
        pieces = frame.segments(ANY, np.zeros(SIZE, np.uint8), Kind.CALL)
        sending = threading.Thread(target=self.sender.send, args=(pieces,))
        sending.start()
        self.receiver.receive(time.monotonic() + LONG)
        sending.join(LONG)
        (self.block,) = self.sender._pool.blocks()
        self.block.memory[0] = BEING_FILLED
        deadline = time.monotonic() + LONG
        self.sender._channel.send(
            pieces[:2], deadline, LARGEST, self.block.number, SIZE
        )


@pytest.fixture
def ends() -> Iterator[Endpoints]:
    """Give both ends."""
    made = Endpoints()
    yield made
    made.sender.close()
    made.receiver.close()


@pytest.fixture
def receiving(ends: Endpoints) -> Iterator[Future[Frame]]:
    """Give what the receiver gets; it sleeps already."""
    with ThreadPoolExecutor() as pool:
        future = pool.submit(ends.receiver.receive, time.monotonic() + LONG)
        wait_until(lambda: ends.block.memory[0] == AWAITED)
        yield future


def test_who_waits_for_the_rest_gets_it(
    ends: Endpoints, receiving: Future[Frame]
) -> None:
    time.sleep(0.1)  # it looks around, and sleeps again
    assert not receiving.done()
    ends.block.memory[shared_memory.DATA : shared_memory.DATA + SIZE] = b"\x07" * SIZE
    ends.block.memory[0] = LENT
    assert (receiving.result(LONG).value(ANY) == 7).all()


def test_a_sender_that_goes_amid_copying_leaves_no_frame(
    ends: Endpoints, receiving: Future[Frame]
) -> None:
    ends.sender.end()
    with pytest.raises(Unavailable, match="closed the connection"):
        receiving.result(LONG)


def test_the_rest_has_a_limit(ends: Endpoints) -> None:
    with pytest.raises(Timeout, match="in time"):
        ends.receiver.receive(time.monotonic() + 0.02)


SENDER = """
import sys, socket
from typing import Any
import numpy as np
from tests.waiting import wait_until
from poise.wire import frame
from tests.waiting import wait_until
from poise.wire.codec import codec
from tests.waiting import wait_until
from poise.wire.frame import Kind
from tests.waiting import wait_until
from poise.wire.connections.connection import Connection

connection = Connection(socket.socket(fileno=int(sys.argv[1])))
array = np.empty(1 << 18, np.uint32)
for number in range(10_000_000):
    array[:] = number
    connection.send(frame.segments(codec(Any), array, Kind.MESSAGE, number=number))
"""


@pytest.fixture
def sender() -> Iterator[tuple[subprocess.Popen[bytes], Connection]]:
    """Give a process that sends arrays of 1 MiB without end, and the other end."""
    ours, theirs = socket.socketpair()
    argv = [sys.executable, "-c", SENDER, str(theirs.fileno())]
    process = subprocess.Popen(argv, pass_fds=[theirs.fileno()])
    theirs.close()
    connection = Connection(ours)
    yield process, connection
    process.kill()
    process.wait(LONG)
    connection.close()


def take(connection: Connection, number: int) -> None:
    received = connection.receive(time.monotonic() + LONG)
    assert received.number == number
    assert (received.value(ANY) == number).all()


def take_all(connection: Connection) -> None:
    for number in itertools.count(1):
        take(connection, number)


def test_a_sender_that_stops_at_any_point_is_waited_for(
    sender: tuple[subprocess.Popen[bytes], Connection],
) -> None:
    process, connection = sender
    take(connection, 0)
    rng = random.Random(1)
    over = threading.Event()

    def stop_again_and_again() -> None:
        for _ in range(100):
            time.sleep(rng.uniform(0, 0.003))
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.003)
            process.send_signal(signal.SIGCONT)
        over.set()

    stopping = threading.Thread(target=stop_again_and_again)
    stopping.start()
    number = 0
    while not over.is_set():
        number += 1
        take(connection, number)
    stopping.join(LONG)


@pytest.mark.parametrize("seed", range(5))
def test_a_sender_that_is_killed_at_any_point_leaves_whole_frames(
    sender: tuple[subprocess.Popen[bytes], Connection], seed: int
) -> None:
    process, connection = sender
    take(connection, 0)
    after = random.Random(seed).uniform(0, 0.02)
    threading.Timer(after, process.kill).start()
    with pytest.raises(Unavailable):
        take_all(connection)
