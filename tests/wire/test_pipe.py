"""Pipes between containers of one computer and of two, with real sockets."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from poise.errors import Timeout, Unavailable
from poise.wire import frame, link_pipe, link_server
from poise.wire.codec import WireError
from poise.wire.frame import Frame, Kind
from poise.wire.link import HEAD, Link
from poise.wire.link_pipe import LinkPipe
from poise.wire.opening import CALLS, MESSAGES
from poise.wire.pipe import Closed, Pieces
from poise.wire.socket_path import socket_path
from poise.wire.stream import LARGEST

from .conftest import (
    LIMIT,
    SHORT,
    TEXT,
    Receiver,
    Wire,
    both,
    call,
    message,
    remote,
    wait_until,
)


@both
def test_a_call_brings_back_its_answer(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    assert wire.pipe().request(call("stressed"), LIMIT).value(TEXT) == "desserts"


@both
def test_each_of_many_callers_gets_its_own_answer(wire: Wire) -> None:
    together = threading.Barrier(8)

    def answer(received: Frame) -> Pieces | None:
        together.wait(LIMIT)  # all eight are in here at the same time
        return Receiver()(received)

    wire.server().open("echo", answer)
    pipe = wire.pipe()
    with ThreadPoolExecutor(8) as callers:
        texts = [f"caller {n}" for n in range(8)]
        answers = callers.map(lambda t: pipe.request(call(t), LIMIT), texts)
        assert [a.value(TEXT) for a in answers] == [t[::-1] for t in texts]


@both
def test_links_are_let_in_again_when_there_are_threads_again(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wire.server().open("echo", Receiver())
    start, refused = threading.Thread.start, threading.Event()

    def none_left(thread: threading.Thread) -> None:
        if thread.name == "link":
            refused.set()
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", none_left)
    with pytest.raises(Unavailable):
        wire.pipe().request(call("ab"), LIMIT)
    assert refused.is_set()
    monkeypatch.undo()
    assert wire.pipe().request(call("ab"), LIMIT).value(TEXT) == "ba"
    assert "there: no link is served: can't start new thread" in caplog.text


@both
def test_a_call_may_come_back_while_it_waits(wire: Wire) -> None:
    pipe = wire.pipe()

    def answer(received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        inner = pipe.request(call(text[1:]), LIMIT).value(TEXT) if text else ""
        return frame.segments(TEXT, f"{text[:1]}({inner})", Kind.RESULT)

    wire.server().open("echo", answer)
    assert pipe.request(call("abc"), LIMIT).value(TEXT) == "a(b(c(())))"


@both
def test_messages_keep_their_order(wire: Wire) -> None:
    receiver = Receiver()
    wire.server().open("echo", receiver)
    pipe = wire.pipe()
    sent = [str(n) for n in range(500)]
    for text in sent:
        pipe.push(message(text), LIMIT)
    assert receiver.wait_for(500) == sent


@both
def test_many_send_over_a_shared_connector_at_the_same_time(wire: Wire) -> None:
    receiver = Receiver()
    server = wire.server()
    server.open("echo", receiver, shared=True)
    first, second = wire.pipe(use=MESSAGES), wire.pipe(use=MESSAGES)
    for number, pipe in enumerate((first, second) * 3, 1):
        pipe.push(message(str(number)), LIMIT)
        receiver.wait_for(number)
    assert len(server._links) == 2  # none ended for another


@both
def test_a_large_message_comes_whole(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    text = "0123456789" * 600_000
    assert wire.pipe().request(call(text), LIMIT).value(TEXT) == text[::-1]


@both
def test_a_slow_receiver_holds_the_sender_up_until_its_limit(wire: Wire) -> None:
    go_on = threading.Event()

    def handle(_: Frame) -> None:
        go_on.wait(LIMIT)

    wire.server().open("echo", handle)
    pipe = wire.pipe()
    pipe.push(message("first"), LIMIT)
    with pytest.raises(Timeout):
        _push_for_ever(pipe)
    go_on.set()


def _push_for_ever(pipe: LinkPipe) -> None:
    while True:
        pipe.push(message("x" * 1_000_000), SHORT)


@both
def test_messages_after_a_time_limit_do_not_overtake_those_before(wire: Wire) -> None:
    came: list[str] = []
    go_on, all_came = threading.Event(), threading.Event()

    def handle(received: Frame) -> None:
        came.append(received.value(TEXT)[:4])
        if came[-1] == "last":
            all_came.set()
        go_on.wait(LIMIT)

    wire.server().open("echo", handle)
    pipe = wire.pipe()
    sent: list[str] = []

    def push(number: str, limit: float, size: int = 0) -> None:
        pipe.push(message(number + size * "x"), limit)
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
    pipe = wire.pipe()
    pipe.push(message("a"), LIMIT)
    together = threading.Barrier(2)
    with ThreadPoolExecutor(2) as callers:

        def ask(text: str) -> Frame:
            together.wait(LIMIT)
            return pipe.request(call(text), LIMIT)

        assert [a.value(TEXT) for a in callers.map(ask, ["ab", "cd"])] == ["ba", "dc"]
    before = [*pipe._calls, *pipe._messages]
    monkeypatch.setattr(link_pipe, "_IDLE", 0.0)
    assert pipe.is_ready()  # they were used since it was last asked
    assert [*pipe._calls, *pipe._messages] == before
    assert pipe.is_ready()
    left = [*pipe._calls, *pipe._messages]
    assert len(left) == 2  # one of each: to open it takes time
    assert {*left} <= {*before}
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_call_that_takes_too_long_is_given_up(wire: Wire) -> None:
    go_on, receiver = threading.Event(), Receiver()

    def answer(received: Frame) -> Pieces | None:
        go_on.wait(LIMIT)
        return receiver(received)

    wire.server().open("echo", answer)
    pipe = wire.pipe()
    wait_until(pipe.is_ready)
    with pytest.raises(Timeout, match="no answer came in time"):
        pipe.request(call("late"), SHORT)
    go_on.set()
    assert pipe.request(call("next"), LIMIT).value(TEXT) == "txen"


@both
def test_nobody_there_is_unavailable(wire: Wire) -> None:
    pipe = wire.pipe()
    assert not pipe.is_ready()
    why = {"local": "nobody at there", "remote": "no container 'there' is here"}
    with pytest.raises(Unavailable, match=f"echo: {why[wire.kind]}"):
        pipe.request(call("?"), LIMIT)
    with pytest.raises(Unavailable):
        pipe.push(message("?"), LIMIT)


@both
def test_a_connector_that_does_not_end_there_is_unavailable(wire: Wire) -> None:
    wire.server().open("other", Receiver())
    pipe = wire.pipe()
    assert not pipe.is_ready()
    with pytest.raises(Unavailable, match="no connector 'echo' ends here"):
        pipe.request(call("?"), LIMIT)


@both
def test_who_was_refused_is_not_asked_all_the_time(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_pipe, "_PAUSE", 1e6)
    monkeypatch.setattr(link_pipe, "_LONGEST_PAUSE", 1e6)
    server, pipe = wire.server(), wire.pipe()
    wait_until(lambda: not pipe.is_ready() and pipe._ask_at > 0.0)
    server.open("echo", Receiver())
    assert not pipe.is_ready()
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"  # a call does ask
    assert pipe.is_ready()


@both
def test_a_connector_that_was_shut_is_unavailable(wire: Wire) -> None:
    server, pipe = wire.server(), wire.pipe()
    server.open("echo", Receiver())
    pipe.request(call("a"), LIMIT)
    server.shut("echo")
    with pytest.raises(Unavailable):
        pipe.request(call("b"), LIMIT)


@both
def test_a_closed_pipe_sends_nothing(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    pipe = wire.pipe()
    pipe.close()
    with pytest.raises(Closed):
        pipe.request(call("a"), LIMIT)


def newcomer(wire: Wire) -> socket.socket:
    """Return a connection to the server that has not named a connector."""
    if wire.kind == "local":
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(str(socket_path(wire.folder, "there")))
    else:
        address = wire.address()
        connection = socket.create_connection((address.host, address.port))
        Link(connection).send(frame.segments(TEXT, "there", Kind.WELCOME))
    connection.settimeout(LIMIT)
    return connection


def everything(connection: socket.socket) -> bytes:
    """Return all that comes until the other end closes."""
    data = b""
    while came := connection.recv(1 << 16):
        data += came
    return data


@both
def test_it_tells_a_newcomer_of_another_version_why(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    with newcomer(wire) as connection:
        hello = b"".join(frame.segments(TEXT, "echo", Kind.WELCOME))
        connection.sendall(HEAD.pack(len(hello), 0) + b"\x07" + hello[1:])
        refusal = frame.parse(everything(connection)[HEAD.size :])
    assert refusal.kind is Kind.ERROR
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
    pipe = wire.pipe()
    monkeypatch.setattr(frame, "segments", newer)
    with pytest.raises(Unavailable, match="protocol version 7"):
        pipe.request(call("?"), LIMIT)


@both
def test_nonsense_ends_its_connection_and_no_other(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    with newcomer(wire) as connection:
        connection.sendall(b"\xff" * 64)
        assert b"is the largest" in everything(connection)
    assert wire.pipe().request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_frame_that_cannot_be_read_is_refused_and_the_link_goes_on(
    wire: Wire,
) -> None:
    refused: list[WireError] = []
    receiver = Receiver()
    wire.server().open("echo", receiver, refused.append)
    pipe = wire.pipe()
    answer = pipe.request([b"\x07nonsense"], LIMIT)
    (link,) = pipe._calls
    assert answer.kind is Kind.ERROR
    assert "cut short" in answer.value(frame.FAILURE)[1]
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"
    assert [*pipe._calls] == [link]
    pipe.push([b"\x07nonsense"], LIMIT)
    pipe.push(message("a"), LIMIT)
    assert receiver.wait_for(1) == ["a"]
    assert len(refused) == 2


@both
def test_a_link_on_which_nothing_more_can_be_read_is_left(wire: Wire) -> None:
    refused: list[WireError] = []
    wire.server().open("echo", Receiver(), refused.append)
    pipe = wire.pipe()
    pipe.request(call("a"), LIMIT)
    (link,) = pipe._calls
    link._connection.sendall(HEAD.pack(LARGEST + 1, 0))
    wait_until(lambda: bool(refused))
    assert "1073741825 B; 1073741824 B is the largest" in str(refused[0])
    answer = link.receive()
    assert answer.number  # it says that it is the last one
    link.end()
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_peer_that_ends_during_a_call_is_unavailable(wire: Wire) -> None:
    server = wire.server()

    def answer(_: Frame) -> Pieces | None:
        server.close()
        return None

    server.open("echo", answer)
    with pytest.raises(Unavailable):
        wire.pipe().request(call("?"), LIMIT)


BLOCKED = """
import pathlib, sys, threading
from poise.wire.link_server import LinkServer

def handle(_):
    print("inside", flush=True)
    threading.Event().wait()

server = LinkServer(pathlib.Path(sys.argv[1]), "there")
server.open("echo", handle)
print("ready", flush=True)
threading.Event().wait()
"""


@both
@pytest.mark.slow
def test_a_container_that_is_killed_during_a_call_is_unavailable(wire: Wire) -> None:
    argv = [sys.executable, "-c", BLOCKED, str(wire.folder)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == b"ready\n"
        with ThreadPoolExecutor() as thread:
            asked = thread.submit(wire.pipe().request, call("?"), LIMIT)
            assert killed.stdout.readline() == b"inside\n"
            killed.kill()
            with pytest.raises(Unavailable, match="the other end is gone"):
                asked.result(LIMIT)
    server = wire.server()
    server.open("echo", Receiver())
    assert wire.pipe().request(call("ab"), LIMIT).value(TEXT) == "ba"


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
        asked = thread.submit(wire.pipe().request, call("ab"), LIMIT)
        assert inside.wait(LIMIT)
        closing.start()
        assert asked.result(LIMIT).value(TEXT) == "ba"
    closing.join(LIMIT)


@both
def test_nothing_is_lost_to_a_peer_that_ended_and_came_back(wire: Wire) -> None:
    first, pipe = wire.server(), wire.pipe()
    first.open("echo", Receiver())
    pipe.request(call("a"), LIMIT)
    pipe.push(message("a"), LIMIT)
    first.close()
    _wait_until_gone(pipe)
    second, receiver = wire.server(), Receiver()
    second.open("echo", receiver)
    pipe.push(message("b"), LIMIT)
    assert pipe.request(call("cd"), LIMIT).value(TEXT) == "dc"
    assert receiver.wait_for(1) == ["b"]


def _wait_until_gone(pipe: LinkPipe) -> None:
    for link in [*pipe._calls, *pipe._messages]:
        link._connection.setblocking(True)
        assert link._connection.recv(1, socket.MSG_PEEK) == b""


@both
def test_a_pipe_is_ready_no_more_when_its_peer_ended(wire: Wire) -> None:
    server, pipe = wire.server(), wire.pipe()
    server.open("echo", Receiver())
    wait_until(pipe.is_ready)
    server.close()
    _wait_until_gone(pipe)
    assert not pipe.is_ready()


@both
def test_a_pipe_whose_only_link_is_used_is_ready(wire: Wire) -> None:
    pipe = wire.pipe()
    found = []

    def answer(received: Frame) -> Pieces | None:
        found.append(pipe.is_ready())
        return Receiver()(received)

    wire.server().open("echo", answer)
    pipe.request(call("a"), LIMIT)
    assert found == [True]
    assert len([*pipe._calls]) == 1


@both
@pytest.mark.parametrize("use", [CALLS, MESSAGES])
def test_what_is_looked_for_is_used(wire: Wire, use: int) -> None:
    server, receiver = wire.server(), Receiver()
    server.open("echo", receiver)
    pipe = wire.pipe(use=use)
    wait_until(pipe.is_ready)
    if use == CALLS:
        pipe.request(call("a"), LIMIT)
    else:
        pipe.push(message("a"), LIMIT)
        receiver.wait_for(1)
    assert len(server._links) == 1


@both
def test_a_closed_pipe_keeps_no_connection(wire: Wire) -> None:
    pipe = wire.pipe()

    def answer(received: Frame) -> Pieces | None:
        pipe.close()
        return Receiver()(received)

    wire.server().open("echo", answer)
    pipe.request(call("a"), LIMIT)
    assert [*pipe._calls] == []


@both
def test_more_links_than_a_container_serves_are_closed(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_server, "_MOST_LINKS", 1)
    server = wire.server()
    server.open("echo", Receiver())
    one, other = wire.pipe(), wire.pipe()
    one.request(call("a"), LIMIT)
    with pytest.raises(Unavailable):
        other.request(call("b"), LIMIT)
    assert one.request(call("ab"), LIMIT).value(TEXT) == "ba"
    one.close()
    wait_until(lambda: not server._links)
    assert other.request(call("ab"), LIMIT).value(TEXT) == "ba"


@both
def test_a_socket_left_by_a_killed_container_is_replaced(wire: Wire) -> None:
    path = socket_path(wire.folder, "there")
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    server, pipe = wire.server(), wire.pipe()
    server.open("echo", Receiver())
    wait_until(pipe.is_ready)
    server.close()
    assert not [*wire.folder.iterdir()]


@remote
def test_whoever_looks_does_not_wait_for_a_computer_that_is_silent(wire: Wire) -> None:
    """A full backlog: the kernel answers no more who wants to connect."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as silent:
        address = silent.getsockname()
        with socket.create_connection(address):
            pipe = LinkPipe("echo", wire.address(), wire.folder)
            pipe._address = type(pipe._address)("there", *address)
            assert not pipe.is_ready()
            assert not pipe.is_ready()
            (opening,) = pipe._openings.values()
            assert not opening._asked
            with pytest.raises(Unavailable, match="no answer from"):
                pipe.push(message("a"), SHORT)
            assert pipe._is_lost
            with pytest.raises(Unavailable, match="no answer from"):
                pipe.push(message("a"), 1e6)  # does not wait a second time
            pipe.close()
