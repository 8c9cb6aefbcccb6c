"""Channels between containers of one computer and of two, with real sockets."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from poise.endpoint import Endpoint
from poise.errors import Timeout, Unavailable
from poise.wire import frame
from poise.wire.address import Address, peek, socket_path
from poise.wire.codec import codec
from poise.wire.connections import channel as channels
from poise.wire.connections import connection, connection_server
from poise.wire.connections.channel import Channel, Closed
from poise.wire.connections.connection import Connection
from poise.wire.connections.opening import CALLS, MESSAGES
from poise.wire.frame import LARGEST, LENGTH, Frame, FrameKind, Pieces
from tests.waiting import LIMIT, wait_until
from tests.wire.conftest import (
    SHORT,
    TEXT,
    Receiver,
    Wire,
    both,
    call,
    message,
    plain,
    plain_remote,
    remote,
)

pytestmark = pytest.mark.slow


@both
def test_a_call_brings_back_its_answer(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    assert wire.channel().request(call("stressed"), LIMIT).value(TEXT) == "desserts"


@both
def test_a_limit_may_be_years(wire: Wire) -> None:
    wire.server().open("echo", receiver := Receiver())
    channel = wire.channel()
    assert channel.request(call("stressed"), 1e8).value(TEXT) == "desserts"
    channel.push(message("late"), 1e8)
    assert receiver.wait_for(1) == ["late"]


@both
def test_each_of_many_callers_gets_its_own_answer(wire: Wire) -> None:
    together = threading.Barrier(8)

    def answer(received: Frame) -> Pieces | None:
        together.wait(LIMIT)  # all eight are in here at the same time
        return Receiver()(received)

    wire.server().open("echo", answer)
    channel = wire.channel()
    with ThreadPoolExecutor(8) as callers:
        texts = [f"caller {n}" for n in range(8)]
        answers = callers.map(lambda t: channel.request(call(t), LIMIT), texts)
        assert [a.value(TEXT) for a in answers] == [t[::-1] for t in texts]


@both
def test_links_are_let_in_again_when_there_are_threads_again(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    server = wire.server()
    server.open("echo", Receiver())
    start, refused = threading.Thread.start, threading.Event()

    def none_left(thread: threading.Thread) -> None:
        if thread.name == "connection":
            refused.set()
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", none_left)
    for _ in range(2):
        with pytest.raises(Unavailable):
            wire.channel().request(call("ab"), LIMIT)
    assert refused.is_set()
    text = "accepts no connection for now: can't start new thread"
    assert text in server.warning.trouble()  # as `status` shows
    monkeypatch.undo()
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"
    assert caplog.text.count(text) == 1


@both
def test_a_call_may_come_back_while_it_waits(wire: Wire) -> None:
    channel = wire.channel()

    def answer(received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        inner = channel.request(call(text[1:]), LIMIT).value(TEXT) if text else ""
        return frame.segments(TEXT, f"{text[:1]}({inner})", FrameKind.RESULT)

    wire.server().open("echo", answer)
    assert channel.request(call("abc"), LIMIT).value(TEXT) == "a(b(c(())))"


@both
def test_it_tells_that_a_call_waits_for_its_answer(wire: Wire) -> None:
    channel = wire.channel()
    found = []

    def answer(received: Frame) -> Pieces | None:
        found.append(channel.is_calling())
        return frame.segments(TEXT, received.value(TEXT), FrameKind.RESULT)

    wire.server().open("echo", answer)
    assert not channel.is_calling()
    channel.request(call("a"), LIMIT)
    assert found == [True]
    assert not channel.is_calling()


@both
def test_messages_keep_their_order(wire: Wire) -> None:
    receiver = Receiver()
    wire.server().open("echo", receiver)
    channel = wire.channel()
    sent = [str(n) for n in range(500)]
    for text in sent:
        channel.push(message(text), LIMIT)
    assert receiver.wait_for(500) == sent


@both
def test_what_comes_back_over_messages_is_taken_and_their_order_stays(
    wire: Wire,
) -> None:
    """Also while messages go, and until the source needs no more."""
    receiver = Receiver()

    def handle(received: Frame) -> None:
        receiver(received)
        back = connection.current_connection()
        assert back is not None
        back.send_back(message(received.value(TEXT)))

    came: list[str] = []
    done = threading.Event()

    def take(received: Frame) -> bool:
        came.append(received.value(TEXT))
        if came[-1] == "99":
            done.set()
        return not done.is_set()

    wire.server().open("echo", handle)
    channel = wire.channel(use=MESSAGES, on_frame=take)
    sent = [str(n) for n in range(100)]
    for text in sent:
        channel.push(message(text), LIMIT)
    assert receiver.wait_for(100) == sent
    assert done.wait(LIMIT)
    assert came == sent
    wait_until(lambda: "credit" not in {t.name for t in threading.enumerate()})
    channel.push(message("more"), LIMIT)
    assert receiver.wait_for(101)[-1] == "more"


@both
def test_a_source_that_takes_nothing_back_holds_nobody_up(wire: Wire) -> None:
    """Its messages still come, in order; then it opens another connection."""
    receiver = Receiver()
    go_on, is_full = threading.Event(), threading.Event()

    def handle(received: Frame) -> None:
        receiver(received)
        back = connection.current_connection()
        assert back is not None
        while not is_full.is_set() and back.send_back(message("x" * 10_000)):
            pass
        is_full.set()

    def take(_: Frame) -> bool:
        assert go_on.wait(LIMIT)
        return True

    wire.server().open("echo", handle)
    channel = wire.channel(use=MESSAGES, on_frame=take)
    channel.push(message("0"), LIMIT)
    assert is_full.wait(LIMIT)
    channel.push(message("1"), LIMIT)
    (first,) = channel._messages
    go_on.set()
    wait_until(lambda: first.is_over)
    channel.push(message("2"), LIMIT)
    assert receiver.wait_for(3) == ["0", "1", "2"]
    assert first not in {*channel._messages}


@both
def test_each_connection_for_messages_says_first_how_many_went_before(
    wire: Wire,
) -> None:
    receiver, sent = Receiver(), [0]

    def count() -> None:
        sent[0] += 1

    wire.server().open("echo", receiver)
    channel = wire.channel(use=MESSAGES, first=lambda: message(f"{sent[0]} went"))
    wait_until(channel.try_connect)
    channel.push(message("a"), LIMIT, count)
    channel.push(message("b"), LIMIT, count)
    assert receiver.wait_for(3) == ["0 went", "a", "b"]
    (connection,) = channel._messages
    connection.end()
    wait_until(channel.try_connect)  # although nothing more is sent
    assert receiver.wait_for(4)[-1] == "2 went"


@both
def test_a_large_message_comes_whole(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    text = "0123456789" * 600_000
    assert wire.channel().request(call(text), LIMIT).value(TEXT) == text[::-1]


@both
def test_a_slow_receiver_holds_the_sender_up_until_its_limit(wire: Wire) -> None:
    go_on = threading.Event()

    def handle(_: Frame) -> None:
        go_on.wait(LIMIT)

    wire.server().open("echo", handle)
    channel = wire.channel()
    channel.push(message("first"), LIMIT)
    with pytest.raises(Timeout):
        _push_for_ever(channel)
    go_on.set()


@remote
def test_a_message_waits_no_more_for_a_computer_that_is_given_up(wire: Wire) -> None:
    """A publisher waited in vain, and so did the move of its component."""
    go_on, first = threading.Event(), threading.Event()

    def handle(_: Frame) -> None:
        first.set()
        go_on.wait(LIMIT)

    wire.server().open("echo", handle)
    channel = wire.channel()
    with ThreadPoolExecutor(1) as pool:
        filling = pool.submit(_push_for_ever, channel, 10 * LIMIT)
        assert first.wait(LIMIT)
        with pytest.raises(TimeoutError):  # it waits for room
            filling.result(1.0)
        channel.give_up()
        with pytest.raises(Unavailable):
            filling.result(LIMIT)
    go_on.set()
    wait_until(channel.try_connect)


def _push_for_ever(channel: Channel, limit: float = SHORT) -> None:
    while True:
        channel.push(message("x" * 1_000_000), limit)


@both
def test_messages_do_not_wait_for_a_sender_that_left_without_a_word(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_server, "_PATIENCE", 0.1)
    monkeypatch.setattr(connection_server, "_RESENDING", 0.1)
    wire.server().open("echo", receiver := Receiver())
    lost, other = wire.channel(), wire.channel()
    lost.push(message("before"), LIMIT)  # its connection stays open
    other.push(message("after"), LIMIT)
    assert receiver.wait_for(2) == ["before", "after"]


@remote
def test_they_wait_for_what_the_senders_computer_sends_again_after_a_cut(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_server, "_PATIENCE", 0.01)
    wire.server().open("echo", receiver := Receiver())
    before, after = wire.channel(), wire.channel()
    before.push(message("first"), LIMIT)
    after.push(message("third"), LIMIT)
    time.sleep(0.3)
    before.push(message("second"), LIMIT)
    before.close()
    assert receiver.wait_for(3) == ["first", "second", "third"]


@both
@pytest.mark.parametrize("pause", [0.0, 0.03])
def test_messages_after_a_time_limit_do_not_overtake_those_before(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, pause: float
) -> None:
    """Nor do those get lost which a slow receiver has not got by then."""
    if pause:
        monkeypatch.setattr(connection_server, "_PATIENCE", 0.25)
        monkeypatch.setattr(connection_server, "_RESENDING", 0.25)
    came: list[str] = []
    go_on, all_came = threading.Event(), threading.Event()

    def handle(received: Frame) -> None:
        came.append(received.value(TEXT)[:4])
        if came[-1] == "last":
            all_came.set()
        go_on.wait(LIMIT)
        time.sleep(pause)

    wire.server().open("echo", handle)
    channel = wire.channel()
    sent: list[str] = []

    def push(number: str, limit: float, size: int = 0) -> None:
        channel.push(message(number + size * "x"), limit)
        sent.append(number)

    def fill() -> None:
        while True:
            push(f"{len(sent):04}", SHORT, 100_000)

    push("0000", LIMIT)
    with pytest.raises(Timeout):
        fill()
    for number in ("new1", "new2", "last"):
        push(number, LIMIT)
    go_on.set()
    assert all_came.wait(LIMIT)
    assert came == sent


@both
def test_what_nobody_uses_is_closed_in_time(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire.server().open("echo", Receiver())
    channel = wire.channel()
    channel.push(message("a"), LIMIT)
    together = threading.Barrier(2)
    with ThreadPoolExecutor(2) as callers:

        def ask(text: str) -> Frame:
            together.wait(LIMIT)
            return channel.request(call(text), LIMIT)

        assert [a.value(TEXT) for a in callers.map(ask, ["ab", "cd"])] == ["ba", "dc"]
    before = [*channel._calls, *channel._messages]
    monkeypatch.setattr(channels, "_IDLE", 0.0)
    assert channel.try_connect()  # they were used since it was last asked
    assert [*channel._calls, *channel._messages] == before
    assert channel.try_connect()
    left = [*channel._calls, *channel._messages]
    assert len(left) == 2  # one of each: to open it takes time
    assert {*left} <= {*before}
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"


class TakenFrom(list[Any]):
    """Another thread has taken the last one just after it was looked for."""

    def __bool__(self) -> bool:
        return True


class PoppedFrom(dict[int, Any]):
    """The same."""

    def __bool__(self) -> bool:
        return True


def test_what_another_thread_has_just_taken_is_not_closed(tmp_path: Path) -> None:
    channel = Channel("echo", Address("there"), tmp_path)
    channel._openings = PoppedFrom()
    for connections in channel._connections:
        connections._older = TakenFrom()
        connections.close_older()
    channel.close()


@both
def test_a_call_that_takes_too_long_is_given_up(wire: Wire) -> None:
    go_on, receiver = threading.Event(), Receiver()

    def answer(received: Frame) -> Pieces | None:
        go_on.wait(LIMIT)
        return receiver(received)

    wire.server().open("echo", answer)
    channel = wire.channel()
    wait_until(channel.try_connect)
    with pytest.raises(Timeout, match="no answer came in time"):
        channel.request(call("late"), SHORT)
    go_on.set()
    assert channel.request(call("next"), LIMIT).value(TEXT) == "txen"


@both
def test_nobody_there_is_unavailable(wire: Wire) -> None:
    channel = wire.channel()
    assert not channel.try_connect()
    why = {
        "local": "nothing listens at there",
        "remote": "no container 'there' is here",
        "tls": "(no container 'there' is here|no TLS session: the answer is plain)",
    }
    with pytest.raises(Unavailable, match=f"echo: {why[wire.kind]}"):
        channel.request(call("?"), LIMIT)
    with pytest.raises(Unavailable):
        channel.push(message("?"), LIMIT)


def test_it_does_not_take_its_own_lack_of_files_for_an_absence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    error = OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    monkeypatch.setattr("socket.socket.connect_ex", Mock(side_effect=error))
    channel = Channel("echo", Address("there"), tmp_path)
    with pytest.raises(Unavailable, match=r"no connection to there: .*Too many open"):
        channel.request(call("?"), LIMIT)


@both
def test_a_connector_that_does_not_end_there_is_unavailable(wire: Wire) -> None:
    wire.server().open("other", Receiver())
    channel = wire.channel()
    assert not channel.try_connect()
    with pytest.raises(Unavailable, match="echo: its other end is not here"):
        channel.request(call("?"), LIMIT)


@both
def test_who_was_refused_is_not_asked_all_the_time(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(channels, "_PAUSE", 1e6)
    server, channel = wire.server(), wire.channel()
    wait_until(lambda: not channel.try_connect() and channel._ask_at > 0.0)
    server.open("echo", Receiver())
    assert not channel.try_connect()
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"  # a call does ask
    assert channel.try_connect()


@both
def test_a_connector_that_was_shut_is_unavailable(wire: Wire) -> None:
    server, channel = wire.server(), wire.channel()
    server.open("echo", Receiver())
    channel.request(call("a"), LIMIT)
    server.shut("echo")
    with pytest.raises(Unavailable):
        channel.request(call("b"), LIMIT)


@both
def test_a_closed_pipe_sends_nothing(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    channel = wire.channel()
    channel.close()
    with pytest.raises(Closed):
        channel.request(call("a"), LIMIT)


def newcomer(wire: Wire) -> socket.socket:
    """Return a connection to the server that has not named a connector."""
    if wire.kind == "local":
        sock = socket.socket(socket.AF_UNIX)
        sock.connect(str(socket_path(wire.folder, "there")))
    else:
        gateway = wire.address().gateway
        assert gateway is not None
        sock = socket.create_connection((gateway.host, gateway.port))
        Connection(sock).send(frame.segments(TEXT, "there", FrameKind.HELLO))
    sock.settimeout(LIMIT)
    return sock


def everything(sock: socket.socket) -> bytes:
    """Return all that comes until the other end closes."""
    data = b""
    while came := sock.recv(1 << 16):
        data += came
    return data


@plain
def test_it_tells_a_newcomer_of_another_version_why(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    with newcomer(wire) as sock:
        hello = b"".join(frame.segments(TEXT, "echo", FrameKind.HELLO))
        sock.sendall(LENGTH.pack(len(hello), 0) + b"\x07" + hello[1:])
        refusal = frame.parse(everything(sock)[LENGTH.size :])
    assert refusal.kind is FrameKind.ERROR
    assert f"protocol version 7, but this is version {frame.VERSION}" in refusal.value(
        TEXT
    )


@both
def test_a_server_of_another_version_is_unavailable(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    welcome = frame.segments

    def newer(*args: object, **more: object) -> Pieces:
        head, *rest = welcome(*args, **more)  # type: ignore[arg-type]
        return [b"\x07" + bytes(head)[1:], *rest]

    wire.server().open("echo", Receiver())
    channel = wire.channel()
    monkeypatch.setattr(frame, "segments", newer)
    # a plain refusal that comes amid a TLS handshake is not read any more
    with pytest.raises(Unavailable, match=r"protocol version 7|the answer is plain"):
        channel.request(call("?"), LIMIT)


@plain
def test_nonsense_ends_its_connection_and_no_other(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    with newcomer(wire) as sock:
        sock.sendall(b"\xff" * 64)
        assert b"is the largest" in everything(sock)
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_frame_that_cannot_be_read_is_refused_and_the_connection_goes_on(
    wire: Wire,
) -> None:
    refused: list[bool] = []
    receiver = Receiver()
    wire.server().open("echo", receiver, lambda: refused.append(True))
    channel = wire.channel()
    answer = channel.request([b"\x07nonsense"], LIMIT)
    (connection,) = channel._calls
    assert answer.kind is FrameKind.ERROR
    assert "cut short" in answer.value(frame.FAILURE)[1]
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
    assert [*channel._calls] == [connection]
    channel.push([b"\x07nonsense"], LIMIT)
    channel.push(message("a"), LIMIT)
    assert receiver.wait_for(1) == ["a"]
    assert len(refused) == 2


@both
def test_an_unreadable_connection_is_closed(wire: Wire) -> None:
    refused: list[bool] = []
    wire.server().open("echo", Receiver(), lambda: refused.append(True))
    channel = wire.channel()
    channel.request(call("a"), LIMIT)
    (connection,) = channel._calls
    connection._connection.sendall(LENGTH.pack(LARGEST + 1, 0))
    wait_until(lambda: bool(refused))
    answer = connection.receive()
    why = answer.value(frame.FAILURE)[1]
    assert "1073741825 B; 1073741824 B is the largest" in why
    assert answer.number  # it says that it is the last one
    connection.end()
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_peer_that_ends_during_a_call_is_unavailable(wire: Wire) -> None:
    server = wire.server()

    def answer(_: Frame) -> Pieces | None:
        server.close()
        return None

    server.open("echo", answer)
    with pytest.raises(Unavailable):
        wire.channel().request(call("?"), LIMIT)


BLOCKED = """
import pathlib, sys, threading
from poise.wire.connections.connection_server import ConnectionServer

def handle(_):
    print("inside", flush=True)
    threading.Event().wait()

server = ConnectionServer(pathlib.Path(sys.argv[1]), "there")
server.open("echo", handle)
print("ready", flush=True)
threading.Event().wait()
"""


@both
def test_a_container_that_is_killed_during_a_call_is_unavailable(wire: Wire) -> None:
    argv = [sys.executable, "-c", BLOCKED, str(wire.folder)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == b"ready\n"
        with ThreadPoolExecutor() as thread:
            asked = thread.submit(wire.channel().request, call("?"), LIMIT)
            assert killed.stdout.readline() == b"inside\n"
            killed.kill()
            with pytest.raises(Unavailable, match="the other end is gone"):
                asked.result(LIMIT)
    server = wire.server()
    server.open("echo", Receiver())
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_calls_that_came_are_answered_though_their_server_closes(wire: Wire) -> None:
    server, inside = wire.server(), threading.Event()
    closing = threading.Thread(target=server.close)

    def answer(received: Frame) -> Pieces | None:
        inside.set()
        wait_until(server._closed.is_set)
        return Receiver()(received)

    server.open("echo", answer)
    with ThreadPoolExecutor() as thread:
        asked = thread.submit(wire.channel().request, call("ab"), LIMIT)
        assert inside.wait(LIMIT)
        closing.start()
        assert asked.result(LIMIT).value(TEXT) == "ba"
    closing.join(LIMIT)


@both
def test_nothing_is_lost_to_a_peer_that_ended_and_came_back(wire: Wire) -> None:
    first, channel = wire.server(), wire.channel()
    first.open("echo", Receiver())
    channel.request(call("a"), LIMIT)
    channel.push(message("a"), LIMIT)
    first.close()
    _wait_until_gone(channel)
    second, receiver = wire.server(), Receiver()
    second.open("echo", receiver)
    channel.push(message("b"), LIMIT)
    assert channel.request(call("cd"), LIMIT).value(TEXT) == "dc"
    assert receiver.wait_for(1) == ["b"]


def _wait_until_gone(channel: Channel) -> None:
    for opened in [*channel._calls, *channel._messages]:
        wait_until(lambda o=opened: peek(o._connection, 1) is not None)  # type: ignore[misc]


@both
def test_a_pipe_is_ready_no_more_when_its_peer_ended(wire: Wire) -> None:
    server, channel = wire.server(), wire.channel()
    server.open("echo", Receiver())
    wait_until(channel.try_connect)
    server.close()
    _wait_until_gone(channel)
    assert not channel.try_connect()


@both
def test_a_lost_connection_is_replaced_and_not_kept_beside_the_next(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a cut it may come back; its receiver would wait for more from it."""
    server, receiver, channel = wire.server(), Receiver(), wire.channel(use=MESSAGES)
    server.open("echo", receiver)
    channel.push(message("a"), LIMIT)
    (lost,) = channel._messages
    monkeypatch.setattr(lost, "is_idle", lambda: False)
    wait_until(channel.try_connect)
    assert lost not in [*channel._messages]
    channel.push(message("b"), LIMIT)
    assert receiver.wait_for(2) == ["a", "b"]
    assert len([*channel._messages]) == 1


@both
def test_a_channel_whose_only_connection_is_used_is_ready(wire: Wire) -> None:
    channel = wire.channel()
    found = []

    def answer(received: Frame) -> Pieces | None:
        found.append(channel.try_connect())
        return Receiver()(received)

    wire.server().open("echo", answer)
    channel.request(call("a"), LIMIT)
    assert found == [True]
    assert len([*channel._calls]) == 1


@both
@pytest.mark.parametrize("use", [CALLS, MESSAGES])
def test_what_is_looked_for_is_used(wire: Wire, use: int) -> None:
    server, receiver = wire.server(), Receiver()
    server.open("echo", receiver)
    channel = wire.channel(use=use)
    wait_until(channel.try_connect)
    if use == CALLS:
        channel.request(call("a"), LIMIT)
    else:
        channel.push(message("a"), LIMIT)
        receiver.wait_for(1)
    with server._lock:  # it may serve before it is counted
        assert len(server._connections) == 1


@both
def test_a_closed_pipe_keeps_no_connection(wire: Wire) -> None:
    channel = wire.channel()

    def answer(received: Frame) -> Pieces | None:
        channel.close()
        return Receiver()(received)

    wire.server().open("echo", answer)
    channel.request(call("a"), LIMIT)
    assert [*channel._calls] == []


@both
def test_more_links_than_a_container_serves_are_closed(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_server, "_MOST_CONNECTIONS", 1)
    server = wire.server()
    server.open("echo", Receiver())
    one, other = wire.channel(), wire.channel()
    one.request(call("a"), LIMIT)
    with pytest.raises(Unavailable):
        other.request(call("b"), LIMIT)
    assert one.request(call("ab"), LIMIT).value(TEXT) == "ba"
    one.close()
    wait_until(lambda: not server._connections)
    assert other.request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_socket_left_by_a_killed_container_is_replaced(wire: Wire) -> None:
    path = socket_path(wire.folder, "there")
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    server, channel = wire.server(), wire.channel()
    server.open("echo", Receiver())
    wait_until(channel.try_connect)
    server.close()
    assert not [*wire.folder.iterdir()]


@remote
def test_whoever_looks_does_not_wait_for_a_computer_that_is_silent(wire: Wire) -> None:
    """A full backlog: the kernel answers no more who wants to connect."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as silent:
        address = silent.getsockname()
        with socket.create_connection(address):
            there = Address("there", Endpoint(*address))
            channel = Channel("echo", there, wire.folder)
            assert not channel.try_connect()
            assert not channel.try_connect()
            (opening,) = channel._openings.values()
            assert not opening._has_asked
            with pytest.raises(Unavailable, match="no answer from"):
                channel.push(message("a"), SHORT)
            assert channel._is_lost
            with pytest.raises(Unavailable, match="no answer from"):
                channel.push(message("a"), 1e6)  # does not wait a second time
            channel.close()


@plain_remote
def test_the_first_call_after_a_short_cut_reaches_the_other_computer(
    wire: Wire,
) -> None:
    """A full backlog drops the first SYN, as a cut does; the kernel waits 1 s then."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as cut:
        there = Address("there", Endpoint(*cut.getsockname()))
        channel = Channel("echo", there, wire.folder)
        with socket.create_connection(cut.getsockname()):
            assert not channel.try_connect()  # the SYN is lost
            with pytest.raises(Unavailable, match="no answer from"):
                channel.push(message("a"), SHORT)
            assert channel._is_lost
            cut.accept()[0].close()  # the cut is over
        with ThreadPoolExecutor(1) as pool:
            answer = pool.submit(channel.request, call("ab"), 0.9)
            peer = Connection(cut.accept()[0])
            hellos = [peer.receive().value(TEXT) for _ in range(2)]
            assert hellos == ["there", "echo"]
            peer.send(frame.segments(TEXT, "echo", FrameKind.HELLO))
            peer.send(Receiver()(peer.receive()) or [])
            assert answer.result(LIMIT).value(TEXT) == "ba"
        peer.close()
        channel.close()


@both
def test_a_channel_without_a_free_file_is_unavailable(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the error ends whoever asks: a component's code, or a container."""
    channel = wire.channel()

    def fail(*_: object) -> socket.socket:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(socket, "socket", fail)
    assert not channel.try_connect()
    with pytest.raises(Unavailable, match="Too many open files"):
        channel.request(call("a"), LIMIT)


@pytest.mark.parametrize("wire", ["local"], indirect=True)
def test_an_answer_brings_a_new_block_over_a_connection_that_was_opened(
    wire: Wire,
) -> None:
    arrays = codec(np.ndarray)

    def answer(received: Frame) -> Pieces:
        return frame.segments(arrays, received.value(arrays) + 1, FrameKind.RESULT)

    wire.server().open("echo", answer)
    channel = wire.channel()
    for number in range(3):
        asked = frame.segments(arrays, np.full(100_000, number), FrameKind.CALL)
        got = channel.request(asked, LIMIT).value(arrays)
        assert got.shape == (100_000,)
        assert (got == number + 1).all()


@pytest.mark.parametrize("wire", ["local"], indirect=True)
@pytest.mark.parametrize("num_queued", [0, 2])
def test_nobody_waits_for_a_container_that_stands_still(
    wire: Wire, num_queued: int
) -> None:
    """Else one frozen container holds up the control threads of its neighbours."""
    path = str(socket_path(wire.folder, "there"))
    with ExitStack() as stack:
        frozen = stack.enter_context(socket.socket(socket.AF_UNIX))
        frozen.bind(path)
        frozen.listen(0)
        for _ in range(num_queued):
            queued = stack.enter_context(socket.socket(socket.AF_UNIX))
            queued.setblocking(False)
            queued.connect_ex(path)
        channels = [wire.channel() for _ in range(100)]
        began = time.monotonic()
        assert not any(channel.try_connect() for channel in channels)
        assert time.monotonic() - began < LIMIT / 2  # it waited 0.2 s for each
        frozen.listen(64)
        with pytest.raises(Unavailable, match="no answer from"):
            channels[0].request(call("a"), SHORT)


def test_a_message_that_waits_for_a_silent_computer_ends_when_that_is_given_up(
    tmp_path: Path,
) -> None:
    """So a component whose publisher waits there can move away from it."""
    with socket.create_server(("127.0.0.1", 0)) as silent, ThreadPoolExecutor() as pool:
        gateway = Endpoint("127.0.0.1", silent.getsockname()[1])
        channel = Channel("echo", Address("there", gateway), tmp_path)
        pushed = pool.submit(channel.push, message("a"), 10 * LIMIT)
        with silent.accept()[0]:
            channel.give_up()
            with pytest.raises(Unavailable, match="no answer from"):
                pushed.result(LIMIT)
        channel.close()
