"""Heartbeats over real sockets."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import msgspec
import pytest

from poise import threads
from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.wire.heartbeats import Contacts, Heartbeats, Received, UdpDatagrams
from poise.wire.records.heartbeat_records import Heartbeat
from tests.runtime.conftest import free_port
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

HOST = "127.0.0.1"


@contextmanager
def flood(port: int) -> Iterator[None]:
    """Send to a port without end, from more threads than there is time to read for."""
    ended = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
            sending.connect((HOST, port))
            while not ended.is_set():
                try:
                    sending.send(b"no heartbeat")
                except ConnectionRefusedError:
                    return

    senders = [threading.Thread(target=send) for _ in range(3)]
    for thread in senders:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in senders:
            thread.join()


def test_heartbeats_go_out_while_others_flood_the_port() -> None:
    clock, number = SystemClock(), 0

    def next_beat() -> tuple[Heartbeat, float]:
        nonlocal number
        number += 1
        beat = Heartbeat(
            robot="r", sender="a", key=str(os.getpid()), number=number, sent=0.0
        )
        return beat, 0.01

    def hear(_: Sequence[Received]) -> bool:
        return False

    listen = Endpoint(HOST, free_port())
    heartbeats = Heartbeats(clock, hear, next_beat, UdpDatagrams(clock, listen))
    with flood(listen.port):
        heartbeats.start()
        wait_until(lambda: number >= 20)  # 0.2 s without the flood
    heartbeats.close()


def test_two_that_answer_each_other_at_once_send_no_more_than_100_a_second() -> None:
    """As an agent that asks its manager, on one computer."""
    sent: list[float] = []
    clock = SystemClock()

    def next_beat() -> tuple[Heartbeat, float]:
        sent.append(clock.now())
        beat = Heartbeat(robot="r", sender="a", key="k", number=len(sent), sent=0.0)
        return beat, 0.1

    listen = Endpoint(HOST, free_port())
    heartbeats = Heartbeats(
        clock, lambda _: True, next_beat, UdpDatagrams(clock, listen)
    )
    heartbeats.send_to({"itself": (HOST, listen.port)})
    heartbeats.start()
    wait_until(lambda: len(sent) >= 20)  # it is answered, too: 0.2 s and not 2 s
    heartbeats.close()
    assert min(b - a for a, b in pairwise(sent)) >= 0.0099


def test_an_error_in_what_hears_them_does_not_end_them(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The thread that fails is started again, and the failure is reported."""
    heard, failures = [], []

    def next_beat() -> tuple[Heartbeat, float]:
        beat = Heartbeat(robot="r", sender="a", key="k", number=1, sent=0.0)
        return beat, 0.01

    def hear(_: Sequence[Received]) -> bool:
        heard.append(1)
        if len(heard) < 3:
            raise KeyError("a bug")
        return False

    hook = threading.excepthook
    threads.hear_failures(lambda name, error: failures.append((name, str(error))))
    listen = Endpoint(HOST, free_port())
    clock = SystemClock()
    heartbeats = Heartbeats(clock, hear, next_beat, UdpDatagrams(clock, listen))
    heartbeats.send_to({"itself": (HOST, listen.port)})
    heartbeats.start()
    try:
        wait_until(lambda: len(heard) >= 5)
    finally:
        heartbeats.close()
        threading.excepthook = hook
    assert failures == [("heartbeats", "'a bug'")] * 2
    assert "KeyError: 'a bug'" in caplog.text


@pytest.mark.parametrize("data", [b"", b"\xff" * 9, bytes(20_000), b"\xd9"])
def test_what_is_no_heartbeat_is_ignored(data: bytes) -> None:
    where = Endpoint(HOST, free_port())
    with contextlib.closing(UdpDatagrams(SystemClock(), where)) as receiver:
        beat = Heartbeat(robot="r", sender="a", key="k", number=1, sent=0.0, heard={})
        good = msgspec.msgpack.encode(beat)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for each in (data, good.replace(b"r", b"\x80", 1), good):
                sender.sendto(each, (where.host, where.port))
        received: list[Received] = []

        def come() -> bool:
            received.extend(receiver.receive(0.0))
            return bool(received)

        wait_until(come)
        assert [each for each, _, _ in received] == [beat]


def test_heartbeats_of_an_ended_start_are_not_news_again() -> None:
    """Somebody may have recorded them."""
    contacts = Contacts("r", "here", "k")
    first, second = (
        Heartbeat(robot="r", sender="a", key=key, number=9, sent=0.0, heard={})
        for key in ("first", "second")
    )
    assert contacts.note(first, 1.0)
    assert contacts.note(second, 2.0)
    assert not contacts.note(first, 3.0)
    assert not contacts.note(msgspec.structs.replace(first, number=10), 3.0)
    assert contacts.get("a").heard_at == 2.0  # type: ignore[union-attr]
