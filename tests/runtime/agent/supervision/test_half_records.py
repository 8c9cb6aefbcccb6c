"""A container that sends a part of a record, and the rest later."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from math import inf

import pytest

from poise.errors import Timeout
from poise.runtime.execution.counters import new_memory
from poise.runtime.supervision.process_host import ControlLink
from poise.waker import wait_readable
from poise.wire import frame
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.status_records import ContainerFailure, ContainerStatus
from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

STATUS = ContainerStatus(name="see", pid=7, cpu=1.5)


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Return the agent's end of a control socket, and the container's."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours, theirs


def test_what_a_container_has_no_room_for_goes_when_it_has(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = ends
    link, reader = ControlLink("see", ours, new_memory()), frame.RecordReader(theirs)
    large = ContainerFailure(reason="x" * 5_000_000)
    link.send(large)  # type: ignore[arg-type]  # any record will do
    link.send(Clocks({}))
    came: list[object] = []
    while len(came) < 2:
        assert wait_readable([theirs.fileno()], LIMIT)
        said = reader.next(ContainerFailure | Clocks)
        came += [] if said is None else [said]
        link.flush()
    assert came == [large, Clocks({})]
    assert not link.is_waiting
    link.close()


def test_what_waits_for_a_container_that_takes_nothing_is_bounded(
    ends: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame, "_MOST_WAITING", 1_000_000)
    link = ControlLink("see", ends[0], new_memory())
    large = ContainerFailure(reason="x" * 900_000)
    link.send(large)  # type: ignore[arg-type]  # any record will do
    link.send(large)  # type: ignore[arg-type]
    with pytest.raises(Timeout, match="unread"):
        link.send(large)  # type: ignore[arg-type]
    link.close()


def test_the_lease_of_what_has_just_ended_may_be_asked_for(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    """The thread of the heartbeats does not know yet."""
    link = ControlLink("see", ends[0], new_memory())
    link.note_born(os.getpid())
    link.extend_lease(inf)
    link.close()
    assert not link.is_lease_past()


def record() -> bytes:
    """Return a status as it is sent."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        frame.send_record(ours, STATUS)
        return theirs.recv(1 << 16)


def test_a_record_may_come_in_pieces_and_nobody_waits_for_the_rest(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = ends
    link = ControlLink("see", ours, new_memory())
    *pieces, last = [bytes([each]) for each in record()]
    for piece in pieces:
        theirs.send(piece)
        assert link.next() is None
    theirs.send(last)
    assert link.next() == STATUS
    link.close()
