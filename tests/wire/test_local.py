"""Pipes over AF_UNIX, with real sockets."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from poise.errors import Timeout, Unavailable
from poise.wire import frame, stream
from poise.wire.frame import Frame, Kind
from poise.wire.local import LocalPipe, LocalServer
from poise.wire.pipe import Pieces

from .conftest import LIMIT, SHORT, TEXT, Receiver, call, message


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "container.sock"


@pytest.fixture
def server(path: Path) -> Iterator[LocalServer]:
    server = LocalServer(path)
    yield server
    server.close()


@pytest.fixture
def pipe(path: Path) -> Iterator[LocalPipe]:
    pipe = LocalPipe("echo", str(path))
    yield pipe
    pipe.close()


def test_a_call_brings_back_its_answer(server: LocalServer, pipe: LocalPipe) -> None:
    server.open("echo", Receiver())
    assert pipe.request(call("stressed"), LIMIT).value(TEXT) == "desserts"


def test_each_of_many_callers_gets_its_own_answer(
    server: LocalServer, pipe: LocalPipe
) -> None:
    together = threading.Barrier(8)

    def answer(received: Frame) -> Pieces | None:
        together.wait(LIMIT)  # all eight are in here at the same time
        return Receiver()(received)

    server.open("echo", answer)
    with ThreadPoolExecutor(8) as callers:
        texts = [f"caller {n}" for n in range(8)]
        answers = callers.map(lambda t: pipe.request(call(t), LIMIT), texts)
        assert [a.value(TEXT) for a in answers] == [t[::-1] for t in texts]


def test_a_call_may_come_back_while_it_waits(
    server: LocalServer, pipe: LocalPipe
) -> None:
    def answer(received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        inner = pipe.request(call(text[1:]), LIMIT).value(TEXT) if text else ""
        return frame.segments(TEXT, f"{text[:1]}({inner})", Kind.RESULT)

    server.open("echo", answer)
    assert pipe.request(call("abc"), LIMIT).value(TEXT) == "a(b(c(())))"


def test_messages_keep_their_order(server: LocalServer, pipe: LocalPipe) -> None:
    receiver = Receiver()
    server.open("echo", receiver)
    sent = [str(n) for n in range(500)]
    for text in sent:
        pipe.push(message(text), LIMIT)
    assert receiver.wait_for(500) == sent


def test_a_slow_receiver_holds_the_sender_up_until_its_limit(
    server: LocalServer, pipe: LocalPipe
) -> None:
    go_on = threading.Event()

    def handle(_: Frame) -> None:
        go_on.wait(LIMIT)

    server.open("echo", handle)
    with pytest.raises(Timeout):
        _push_for_ever(pipe)
    go_on.set()


def _push_for_ever(pipe: LocalPipe) -> None:
    while True:
        pipe.push(message("x" * 100_000), SHORT)


def test_messages_after_a_time_limit_do_not_overtake_those_before(
    server: LocalServer, pipe: LocalPipe
) -> None:
    came: list[str] = []
    go_on, all_came = threading.Event(), threading.Event()

    def handle(received: Frame) -> None:
        came.append(received.value(TEXT)[:4])
        if came[-1] == "last":
            all_came.set()
        go_on.wait(LIMIT)

    server.open("echo", handle)
    sent: list[str] = []

    def push(number: str, limit: float, size: int = 0) -> None:
        pipe.push(message(number + size * "x"), limit)
        sent.append(number)

    def fill() -> None:
        while True:
            push(f"{len(sent):04}", SHORT, 10_000)

    with pytest.raises(Timeout):
        fill()
    for number in ("new1", "new2", "last"):
        push(number, LIMIT)
    go_on.set()
    assert all_came.wait(LIMIT)
    assert came == sent


def test_what_nobody_uses_is_closed_in_time(
    server: LocalServer, pipe: LocalPipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.open("echo", Receiver())
    pipe.request(call("a"), LIMIT)
    pipe.push(message("b"), LIMIT)
    before = [*pipe._calls, *pipe._messages]
    monkeypatch.setattr("poise.wire.local._IDLE", 0.0)
    assert pipe.is_ready()  # they were used since it was last asked
    assert [*pipe._calls, *pipe._messages] == before
    assert pipe.is_ready()  # by a new one
    assert not {*pipe._calls, *pipe._messages} & {*before}
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"


def test_a_call_that_takes_too_long_is_given_up(
    server: LocalServer, pipe: LocalPipe
) -> None:
    go_on, receiver = threading.Event(), Receiver()

    def answer(received: Frame) -> Pieces | None:
        go_on.wait(LIMIT)
        return receiver(received)

    server.open("echo", answer)
    with pytest.raises(Timeout):
        pipe.request(call("late"), SHORT)
    go_on.set()
    assert pipe.request(call("next"), LIMIT).value(TEXT) == "txen"


def test_nobody_there_is_unavailable(pipe: LocalPipe, path: Path) -> None:
    assert not pipe.is_ready()
    with pytest.raises(Unavailable, match=f"echo: nobody at {path}"):
        pipe.request(call("?"), LIMIT)
    with pytest.raises(Unavailable):
        pipe.push(message("?"), LIMIT)


def test_a_connector_that_does_not_end_there_is_unavailable(
    server: LocalServer, pipe: LocalPipe
) -> None:
    server.open("other", Receiver())
    assert not pipe.is_ready()
    with pytest.raises(Unavailable, match="no connector 'echo' ends here"):
        pipe.request(call("?"), LIMIT)


def test_a_server_of_another_version_is_unavailable(
    pipe: LocalPipe, path: Path
) -> None:
    def welcome() -> None:
        with listener.accept()[0] as connection:
            stream.receive(connection)
            ours = b"".join(frame.segments(TEXT, "echo", Kind.WELCOME))
            stream.send(connection, [b"\x07", ours[1:]])

    with socket.socket(socket.AF_UNIX) as listener, ThreadPoolExecutor() as thread:
        listener.bind(str(path))
        listener.listen()
        thread.submit(welcome)
        with pytest.raises(Unavailable, match="protocol version 7"):
            pipe.request(call("?"), LIMIT)


def test_it_tells_a_newcomer_of_another_version_why(
    server: LocalServer, path: Path
) -> None:
    server.open("echo", Receiver())
    with socket.socket(socket.AF_UNIX) as newcomer:
        newcomer.connect(str(path))
        stream.set_limit(newcomer, LIMIT)
        hello = b"".join(frame.segments(TEXT, "echo", Kind.WELCOME))
        stream.send(newcomer, [b"\x07", hello[1:]])
        refusal = frame.parse(stream.receive(newcomer))
    assert refusal.kind is Kind.ERROR
    assert "protocol version 7, but this is version 2" in refusal.value(TEXT)


def test_nonsense_ends_its_connection_and_no_other(
    server: LocalServer, pipe: LocalPipe, path: Path
) -> None:
    server.open("echo", Receiver())
    with socket.socket(socket.AF_UNIX) as newcomer:
        newcomer.connect(str(path))
        stream.set_limit(newcomer, LIMIT)
        newcomer.sendall(b"\xff" * 64)
        stream.receive(newcomer)  # why
        with pytest.raises(Unavailable):
            stream.receive(newcomer)
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"


def test_a_peer_that_ends_during_a_call_is_unavailable(
    server: LocalServer, pipe: LocalPipe
) -> None:
    def answer(_: Frame) -> Pieces | None:
        server.close()
        return None

    server.open("echo", answer)
    with pytest.raises(Unavailable):
        pipe.request(call("?"), LIMIT)


def test_nothing_is_lost_to_a_peer_that_ended_and_came_back(
    path: Path, pipe: LocalPipe
) -> None:
    first = LocalServer(path)
    first.open("echo", Receiver())
    pipe.request(call("a"), LIMIT)
    first.close()
    _wait_until_gone(pipe)
    second, receiver = LocalServer(path), Receiver()
    second.open("echo", receiver)
    pipe.push(message("b"), LIMIT)
    assert pipe.request(call("cd"), LIMIT).value(TEXT) == "dc"
    assert receiver.wait_for(1) == ["b"]
    second.close()


def _wait_until_gone(pipe: LocalPipe) -> None:
    (link,) = pipe._calls
    link._connection.recv(1, socket.MSG_PEEK)


def test_a_pipe_is_ready_no_more_when_its_peer_ended(
    server: LocalServer, pipe: LocalPipe
) -> None:
    server.open("echo", Receiver())
    assert pipe.is_ready()
    server.close()
    _wait_until_gone(pipe)
    assert not pipe.is_ready()


def test_a_closed_pipe_keeps_no_connection(
    server: LocalServer, pipe: LocalPipe
) -> None:
    def answer(received: Frame) -> Pieces | None:
        pipe.close()
        return Receiver()(received)

    server.open("echo", answer)
    pipe.request(call("a"), LIMIT)
    assert list(pipe._calls) == []


def test_a_socket_file_left_by_a_killed_container_is_replaced(
    path: Path, pipe: LocalPipe
) -> None:
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    server = LocalServer(path)
    server.open("echo", Receiver())
    assert pipe.is_ready()
    server.close()
    assert not path.exists()
