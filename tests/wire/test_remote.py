"""Pipes over zenoh, with real sessions on the loopback interface."""

from __future__ import annotations

import platform
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh

from poise.errors import RunError, Timeout, Unavailable
from poise.wire import frame
from poise.wire.codec import WireError
from poise.wire.frame import Frame, Kind
from poise.wire.pipe import Pieces
from poise.wire.remote import RemotePipe, RemoteServer, open_session

from .conftest import LIMIT, TEXT, Receiver, call, message

Sessions = tuple[zenoh.Session, zenoh.Session]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture(scope="module")
def sessions() -> Iterator[Sessions]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        open_session(listen=[endpoint]) as ours,
        open_session(connect=[endpoint]) as theirs,
    ):
        yield ours, theirs


@pytest.fixture
def prefix(request: pytest.FixtureRequest) -> str:
    """Keys of its own for each test: zenoh forgets the last test's in its own time."""
    return f"test/{request.node.name}"


@pytest.fixture
def server(sessions: Sessions, prefix: str) -> Iterator[RemoteServer]:
    server = RemoteServer(sessions[0], prefix)
    yield server
    server.close()


@pytest.fixture
def pipe(sessions: Sessions, prefix: str) -> Iterator[RemotePipe]:
    pipe = RemotePipe(sessions[1], f"{prefix}/echo", LIMIT)
    yield pipe
    pipe.close()


def wait_until_ready(pipe: RemotePipe) -> None:
    ready = threading.Event()

    def look(_: object) -> None:
        if pipe.is_ready():
            ready.set()

    listeners = [
        entity.declare_matching_listener(look)
        for entity in (pipe._querier, pipe._publisher)
        if entity is not None
    ]
    assert pipe.is_ready() or ready.wait(LIMIT)
    for listener in listeners:
        listener.undeclare()  # type: ignore[no-untyped-call]


def test_a_call_brings_back_its_answer(server: RemoteServer, pipe: RemotePipe) -> None:
    server.open("echo", Receiver())
    wait_until_ready(pipe)
    assert pipe.request(call("stressed"), LIMIT).value(TEXT) == "desserts"


def test_each_of_many_callers_gets_its_own_answer(
    server: RemoteServer, pipe: RemotePipe
) -> None:
    together = threading.Barrier(8)

    def answer(received: Frame) -> Pieces | None:
        together.wait(LIMIT)  # all eight are in here at the same time
        return Receiver()(received)

    server.open("echo", answer)
    wait_until_ready(pipe)
    with ThreadPoolExecutor(8) as callers:
        texts = [f"caller {n}" for n in range(8)]
        answers = callers.map(lambda t: pipe.request(call(t), LIMIT), texts)
        assert [a.value(TEXT) for a in answers] == [t[::-1] for t in texts]


def test_a_call_may_come_back_while_it_waits(
    server: RemoteServer, pipe: RemotePipe
) -> None:
    def answer(received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        inner = pipe.request(call(text[1:]), LIMIT).value(TEXT) if text else ""
        return frame.segments(TEXT, f"{text[:1]}({inner})", Kind.RESULT)

    server.open("echo", answer)
    wait_until_ready(pipe)
    assert pipe.request(call("abc"), LIMIT).value(TEXT) == "a(b(c(())))"


def test_a_handler_of_messages_may_call_others(
    server: RemoteServer, sessions: Sessions, pipe: RemotePipe, prefix: str
) -> None:
    back = RemotePipe(sessions[0], f"{prefix}/back", LIMIT)
    other = RemoteServer(sessions[1], prefix)
    other.open("back", Receiver())
    answers, came = [], threading.Event()

    def ask(received: Frame) -> None:
        answers.append(back.request(call(received.value(TEXT)), LIMIT).value(TEXT))
        came.set()

    server.open("echo", ask)
    wait_until_ready(pipe)
    wait_until_ready(back)
    pipe.push(message("ab"), LIMIT)
    assert came.wait(LIMIT)
    assert answers == ["ba"]
    back.close()
    other.close()


def test_messages_keep_their_order(server: RemoteServer, pipe: RemotePipe) -> None:
    receiver = Receiver()
    server.open("echo", receiver, most=500)  # all may wait: pushing is quicker
    wait_until_ready(pipe)
    sent = [str(n) for n in range(500)]
    for text in sent:
        pipe.push(message(text), LIMIT)
    assert receiver.wait_for(500) == sent


def test_nobody_there_is_unavailable(pipe: RemotePipe, prefix: str) -> None:
    assert not pipe.is_ready()
    with pytest.raises(Unavailable, match=f"nobody answers at {prefix}/echo/call"):
        pipe.request(call("?"), LIMIT)
    with pytest.raises(Unavailable, match=f"nobody listens at {prefix}/echo/message"):
        pipe.push(message("?"), LIMIT)


def test_a_call_that_takes_too_long_is_given_up(
    server: RemoteServer, sessions: Sessions, prefix: str
) -> None:
    go_on, receiver = threading.Event(), Receiver()

    def answer(received: Frame) -> Pieces | None:
        go_on.wait(LIMIT)
        return receiver(received)

    server.open("echo", answer)
    pipe = RemotePipe(sessions[1], f"{prefix}/echo", 0.1)
    wait_until_ready(pipe)
    with pytest.raises(Timeout, match="no answer within"):
        pipe.request(call("late"), 0.1)
    go_on.set()
    pipe.close()


def test_a_server_that_shut_is_unavailable(
    server: RemoteServer, pipe: RemotePipe
) -> None:
    server.open("echo", Receiver())
    wait_until_ready(pipe)
    server.shut("echo")
    with pytest.raises(Unavailable):
        _ask_for_ever(pipe)  # until zenoh has told that it is gone


def _ask_for_ever(pipe: RemotePipe) -> None:
    while True:
        pipe.request(call("?"), LIMIT)


def test_nonsense_is_refused_at_once_and_counted_and_harms_nobody(
    server: RemoteServer, pipe: RemotePipe
) -> None:
    refused: list[WireError] = []
    server.open("echo", Receiver(), refused.append)
    wait_until_ready(pipe)
    answer = pipe.request([b"\x07nonsense"], LIMIT)
    assert answer.kind is Kind.ERROR
    assert "cut short" in answer.value(frame.FAILURE)[1]
    assert len(refused) == 1
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"


def test_a_pipe_for_messages_alone_takes_no_calls(
    server: RemoteServer, sessions: Sessions, prefix: str
) -> None:
    receiver = Receiver()
    server.open("topic", receiver, calls=False)
    pipe = RemotePipe(sessions[1], f"{prefix}/topic", LIMIT, calls=False)
    wait_until_ready(pipe)
    pipe.push(message("ab"), LIMIT)
    assert receiver.wait_for(1) == ["ab"]
    with pytest.raises(Unavailable, match="for messages only"):
        pipe.request(call("ab"), LIMIT)
    pipe.close()


def test_a_handler_that_is_slow_keeps_nothing_else_waiting(
    server: RemoteServer, pipe: RemotePipe, sessions: Sessions, prefix: str
) -> None:
    """More comes than its ring takes: the oldest are lost, calls go on."""
    inside, go_on, receiver = threading.Event(), threading.Event(), Receiver()

    def slow(received: Frame) -> Pieces | None:
        inside.set()
        assert go_on.wait(LIMIT)
        return receiver(received)

    server.open("topic", slow, most=4, calls=False)
    server.open("echo", Receiver())
    topic = RemotePipe(sessions[1], f"{prefix}/topic", LIMIT, calls=False)
    wait_until_ready(pipe)
    wait_until_ready(topic)
    topic.push(message("first"), LIMIT)
    assert inside.wait(LIMIT)
    for number in range(1000):
        topic.push(message(str(number)), LIMIT)
    assert pipe.request(call("ab"), LIMIT).value(TEXT) == "ba"
    go_on.set()
    assert receiver.wait_for(5) == ["first", "996", "997", "998", "999"]
    topic.close()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_memory_of_large_messages_is_kept_for_the_next() -> None:
    code = """
import resource
from poise.wire.remote import keep_memory
keep_memory()

def faults():
    for _ in range(20):
        bytes(6 << 20), b"".join([bytes(6 << 20)])
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

faults()
before = faults()
print(faults() - before)
"""
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert int(told.stdout) < 1536  # one block's pages; without it, 60 times as many


@pytest.mark.parametrize(
    ("address", "why"),
    [("203.0.113.9:7447", "Cannot assign"), ("127.0.0.1:{busy}", "in use")],
)
def test_an_address_that_cannot_be_had_is_an_error(address: str, why: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        endpoint = "tcp/" + address.format(busy=busy.getsockname()[1])
        with pytest.raises(RunError, match=f"cannot listen on {endpoint}: .*{why}"):
            open_session(listen=[endpoint])
