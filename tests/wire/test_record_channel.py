"""Records over a socket: whole, cut, wrong, too many, and in silence."""

from __future__ import annotations

import select
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from msgspec import Struct

from poise.errors import Timeout, Unavailable
from poise.wire import frame
from poise.wire.codec import WireError, codec
from poise.wire.frame import LARGEST, FrameKind

pytestmark = pytest.mark.slow

Pair = tuple[socket.socket, socket.socket]
LIMIT = 20.0
LARGE = 10_000_000
"""More than the sockets hold [bytes]."""


class Word(Struct, frozen=True):
    text: str


@pytest.fixture
def pair() -> Iterator[Pair]:
    with ExitStack() as stack:
        one, other = (stack.enter_context(each) for each in socket.socketpair())
        yield one, other


def test_records_come_whole_and_in_order(pair: Pair) -> None:
    for text in ("", "one", "two"):
        frame.send_record(pair[0], Word(text))
    texts = [frame.receive_record(pair[1], Word).text for _ in range(3)]
    assert texts == ["", "one", "two"]


def test_a_record_that_waits_is_seen_by_poll(pair: Pair) -> None:
    """Nothing of the next record is taken: else its receiver would sleep."""
    for text in ("one", "two"):
        frame.send_record(pair[0], Word(text))
    frame.receive_record(pair[1], Word)
    assert select.select([pair[1]], [], [], 0.0)[0]
    frame.receive_record(pair[1], Word)
    assert not select.select([pair[1]], [], [], 0.0)[0]


def test_a_record_larger_than_the_socket_comes_whole(pair: Pair) -> None:
    sent = Word("x" * LARGE)
    sending = threading.Thread(target=frame.send_record, args=(pair[0], sent))
    sending.start()
    assert frame.receive_record(pair[1], Word) == sent
    sending.join(LIMIT)


@pytest.mark.parametrize("cut", [b"", b"\x09", struct.pack("<II", 9, 0) + b"part"])
def test_a_connection_that_ends_early_is_unavailable(pair: Pair, cut: bytes) -> None:
    pair[0].sendall(cut)
    pair[0].close()
    with pytest.raises(Unavailable):
        frame.receive_record(pair[1], Word)


def test_a_record_out_of_range_is_refused_unread(pair: Pair) -> None:
    pair[0].sendall(struct.pack("<II", LARGEST + 1, 0))
    with pytest.raises(WireError, match="is the largest"):
        frame.receive_record(pair[1], Word)


def test_a_frame_that_is_no_record_is_refused(pair: Pair) -> None:
    (head, body) = frame.segments(codec(Word), Word("a"), FrameKind.MESSAGE)
    pair[0].sendall(struct.pack("<II", len(head) + len(body), 0) + head + body)
    with pytest.raises(WireError, match="MESSAGE, not a record"):
        frame.receive_record(pair[1], Word)


def test_shared_memory_is_refused(pair: Pair) -> None:
    pair[0].sendall(struct.pack("<IIQ", 0, 1, 8))
    with pytest.raises(WireError, match="shared memory"):
        frame.receive_record(pair[1], Word)


def test_silence_ends_at_the_limit(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame, "RECORD_LIMIT", 0.01)
    with pytest.raises(Timeout):
        frame.receive_record(pair[1], Word)
    with pytest.raises(Timeout):
        frame.send_record(pair[0], Word("x" * LARGE))


def test_sending_to_a_closed_socket_is_unavailable(pair: Pair) -> None:
    pair[1].close()
    with pytest.raises(Unavailable):
        frame.send_record(pair[0], Word("anybody?"))


def test_a_packet_holds_one_record() -> None:
    packet = frame.pack_record(Word("a"))
    assert frame.unpack_record(packet, Word | None) == Word("a")
    with pytest.raises(WireError):
        frame.unpack_record(packet[:-1], Word)


def test_a_record_that_was_cut_short_goes_on_with_the_next(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame, "RECORD_LIMIT", 0.1)
    writer, reader = frame.RecordWriter(pair[0]), frame.RecordReader(pair[1])
    with pytest.raises(Timeout):
        writer.send(Word("x" * LARGE))
    with pytest.raises(Timeout):  # it has not begun
        writer.send(Word("lost"))
    monkeypatch.setattr(frame, "RECORD_LIMIT", LIMIT)
    sending = threading.Thread(target=writer.send, args=(Word("next"),))
    sending.start()
    came = list[Word]()
    while len(came) < 2:
        assert select.select([pair[1]], [], [], LIMIT)[0]
        if (word := reader.next(Word)) is not None:
            came.append(word)
    sending.join(LIMIT)
    assert came == [Word("x" * LARGE), Word("next")]


def test_writing_to_a_closed_socket_is_unavailable(pair: Pair) -> None:
    pair[1].close()
    with pytest.raises(Unavailable):
        frame.RecordWriter(pair[0]).send(Word("a"))
