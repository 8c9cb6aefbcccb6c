"""Frames over a stream socket: cut, too large, slow."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from poise.errors import Timeout, Unavailable
from poise.wire.codec import WireError
from poise.wire.connections import stream

Endpoints = tuple[socket.socket, socket.socket]


@pytest.fixture
def ends() -> Iterator[Endpoints]:
    with ExitStack() as stack:
        one, other = (stack.enter_context(e) for e in socket.socketpair())
        for end in (one, other):
            stream.set_limit(end, 20.0)
        yield one, other


def test_the_pieces_of_a_frame_come_as_one(ends: Endpoints) -> None:
    stream.send(ends[0], [b"head", memoryview(b"body"), b""])
    assert stream.receive(ends[1]) == b"headbody"


def test_frames_keep_their_order_and_borders(ends: Endpoints) -> None:
    for frame in (b"", b"one", b"two"):
        stream.send(ends[0], [frame])
    assert [stream.receive(ends[1]) for _ in range(3)] == [b"", b"one", b"two"]


def test_a_frame_larger_than_the_socket_holds_comes_whole(ends: Endpoints) -> None:
    sent = bytes(range(256)) * 20_000
    sender = threading.Thread(target=stream.send, args=(ends[0], [sent]))
    sender.start()
    assert stream.receive(ends[1]) == sent
    sender.join(10)


@pytest.mark.parametrize("cut", [b"", b"\x05", struct.pack("<Q", 5) + b"abc"])
def test_a_frame_that_is_cut_is_no_frame(ends: Endpoints, cut: bytes) -> None:
    ends[0].sendall(cut)
    ends[0].close()
    with pytest.raises(Unavailable, match="closed"):
        stream.receive(ends[1])


def test_an_announced_size_out_of_range_is_refused_unread(ends: Endpoints) -> None:
    ends[0].sendall(struct.pack("<Q", stream.LARGEST + 1))
    with pytest.raises(WireError, match="1073741825 B; 1073741824 B is the largest"):
        stream.receive(ends[1])


def test_a_frame_too_large_to_be_taken_is_not_sent(
    ends: Endpoints, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "LARGEST", 3)
    with pytest.raises(WireError, match="4 B; 3 B is the largest"):
        stream.send(ends[0], [b"12", b"34"])
    stream.send(ends[0], [b"123"])
    assert stream.receive(ends[1]) == b"123"


def test_silence_ends_at_the_limit(ends: Endpoints) -> None:
    stream.set_limit(ends[1], 0.01)
    with pytest.raises(Timeout):
        stream.receive(ends[1])


def test_nobody_who_reads_ends_at_the_limit(ends: Endpoints) -> None:
    stream.set_limit(ends[0], 0.01)
    with pytest.raises(Timeout):
        stream.send(ends[0], [bytes(10_000_000)])


def test_a_dripping_sender_does_not_outlast_the_limit() -> None:
    class Dripping:
        """Each byte comes well within the socket's own limit."""

        def recv_into(self, view: memoryview) -> int:
            view[0] = 1
            return 1

    with pytest.raises(Timeout):
        stream.receive(Dripping(), limit=0.0)  # type: ignore[arg-type]


def test_a_sipping_reader_does_not_outlast_the_limit() -> None:
    class Sipping:
        def sendmsg(self, _: object) -> int:
            return 1

    with pytest.raises(Timeout):
        stream.send(Sipping(), [b"longer"], limit=0.0)  # type: ignore[arg-type]


def test_sending_to_one_that_went_is_unavailable(ends: Endpoints) -> None:
    ends[1].close()
    with pytest.raises(Unavailable, match="gone"):
        stream.send(ends[0], [b"anybody?"])
