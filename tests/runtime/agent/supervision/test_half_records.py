"""A container that sends a part of a record, and the rest late or never."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from poise.runtime.agent.sampling.watchdog import Silence
from poise.runtime.agent.supervision.container_processes import (
    REST_LIMIT,
    ContainerProcess,
)
from poise.runtime.agent.supervision.supervisor import Supervisor
from poise.runtime.hosting.stats_page import new_memory
from poise.runtime.hosting.wiring import Place
from poise.wire import record_channel
from poise.wire.records.deployment import ContainerSpec, Deployment
from poise.wire.records.status import ContainerStatus

pytestmark = pytest.mark.slow

SPEC = ContainerSpec(name="see", folder="", components=(), connectors=())
STATUS = ContainerStatus(name="see", pid=7, cpu=1.5)


class Time:
    """The system's clock, set ahead by hand."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic() + self.ahead

    def sleep(self, seconds: float) -> None:
        """Advance."""
        self.ahead += seconds


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Return the agent's end of a control socket, and the container's."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours, theirs


def record() -> bytes:
    """Return a status as it is sent."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        record_channel.send(ours, STATUS)
        return theirs.recv(1 << 16)


def supervised(process: ContainerProcess, clock: Time) -> Supervisor:
    """Return a supervisor of one process; it asks nothing of its zygote."""
    place = Place(container="see", folder="", gateway="", computer="a")
    supervisor = Supervisor(process.connection, lambda _: place, clock)
    supervisor.take(Deployment(generation=1, containers=(SPEC,)))
    supervisor.processes["see"] = process
    return supervisor


def test_a_record_may_come_in_pieces_and_nobody_waits_for_the_rest(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = ends
    process = ContainerProcess(SPEC, ours, new_memory())
    *pieces, last = [bytes([each]) for each in record()]
    for piece in pieces:
        theirs.send(piece)
        assert process.hear() is None
        assert process.status is None
        assert process.rest_by < float("inf")
    theirs.send(last)
    process.hear()
    assert process.status == STATUS
    assert process.rest_by == float("inf")
    process.close()


@pytest.mark.parametrize("silence", ["its process is stopped (SIGSTOP)", ""])
def test_one_that_owes_the_rest_for_long_is_given_up_with_the_reason(
    ends: tuple[socket.socket, socket.socket], silence: str
) -> None:
    ours, theirs = ends
    process = ContainerProcess(SPEC, ours, new_memory())
    clock = Time()
    supervisor = supervised(process, clock)
    theirs.send(record()[:20])
    process.hear()
    if silence:
        process.silence = Silence(container="see", pid=7, seconds=1, reason=silence)
    clock.sleep(REST_LIMIT - 1)
    supervisor.reconcile()
    assert process.last_error() == ""
    assert process.rest_by in supervisor.moments()
    clock.sleep(1)
    supervisor.reconcile()
    assert process.last_error() == (
        "its agent gave it up: the rest of a record took over 10 s: "
        + (silence or "the reason is not known")
    )
    process.close()
