"""Descriptors that cross a socket: no peer can leave any behind."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

import pytest
from msgspec import Struct

from poise.errors import Unavailable
from poise.runtime.container.agent_link import Orphan, hand_over, take_over
from poise.wire import frame
from poise.wire.codec import WireError
from poise.wire.connections.connection import Connection
from poise.wire.frame import LENGTH

pytestmark = pytest.mark.slow


class Word(Struct, frozen=True):
    text: str


def num_open() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def framed(text: str) -> bytes:
    body = frame.pack_record(Word(text))
    return LENGTH.pack(len(body), 0) + body


@pytest.mark.parametrize("num_files", [1, 2, 5])
def test_files_that_come_with_records_are_closed(num_files: int) -> None:
    ours, theirs = socket.socketpair()
    before = num_open()
    with ours, theirs:
        for text in "abc":
            files = [0] * num_files
            socket.send_fds(theirs, [framed(text)], files)
            assert frame.receive_record(ours, Word).text == text
            assert num_open() == before


def test_files_that_belong_to_no_frame_end_the_connection() -> None:
    """A peer attaches one to each byte of a frame that it never ends."""
    ours, theirs = socket.socketpair()
    before = num_open()
    with ours, theirs:
        for byte in framed("x" * 20):
            socket.send_fds(theirs, [bytes([byte])], [0])
        with pytest.raises(Unavailable):
            Connection(ours).receive(time.monotonic() + frame.RECORD_LIMIT)
        assert num_open() == before


def test_what_is_no_record_leaves_no_files() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        before = num_open()
        socket.send_fds(theirs, [b"8 bytes."], [0, 0])
        with pytest.raises(WireError):
            take_over(ours, Orphan)
        assert num_open() == before
        socket.send_fds(theirs, [frame.pack_record(ORPHAN)], [0])
        assert take_over(ours, Orphan) == (ORPHAN, None, -1)
        assert num_open() == before


def test_what_is_handed_over_is_taken_over() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    page = os.memfd_create("page")
    with ours, theirs, hand_over(theirs, ORPHAN, page) as control:
        orphan, connection, taken = take_over(ours, Orphan)
        assert orphan == ORPHAN
        assert connection is not None
        with connection:
            connection.send(b"!")
            assert control.recv(1) == b"!"
        assert os.fstat(taken).st_ino == os.fstat(page).st_ino
        os.close(taken)
    os.close(page)


ORPHAN = Orphan(container="see", pid=7)
