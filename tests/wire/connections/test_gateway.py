"""The gateway hands each connection on to a container, or refuses it and says why."""

from __future__ import annotations

import contextlib
import resource
import socket
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from poise import errors
from poise.errors import RunError, Unavailable
from poise.wire import frame
from poise.wire.address import Address, gateway_path
from poise.wire.connections import connection_server, opening
from poise.wire.connections import gateway as gateway_module
from poise.wire.connections.channel import Channel
from poise.wire.connections.connection import Connection
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.connections.gateway import Gateway
from poise.wire.connections.opening import MESSAGES
from poise.wire.frame import LENGTH, VERSION, FrameKind
from tests.waiting import LIMIT, wait_until
from tests.wire.conftest import (
    TEXT,
    Receiver,
    Wire,
    call,
    message,
    plain_remote,
    remote,
)

pytestmark = pytest.mark.slow

ANYBODY = "127.0.0.1"
STANDARD_STREAMS = 3
"""These files are always open, and none of these numbers is given again."""


def come(wire: Wire) -> socket.socket:
    gateway = wire.address().gateway
    assert gateway is not None
    return socket.create_connection((gateway.host, gateway.port), LIMIT)


def everything(sock: socket.socket) -> bytes:
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while came := sock.recv(1 << 16):
            data += came
    return data


def said(version: bytes, kind: FrameKind) -> bytes:
    """Return a first frame of some version and kind."""
    text = b"".join(frame.segments(TEXT, "there", kind))
    return LENGTH.pack(len(text), 0) + version + text[1:]


@remote
@pytest.mark.parametrize(
    ("data", "why"),
    [
        pytest.param(b"GET / HTTP/1.1\r\n\r\n", "1024 B is the largest", id="another"),
        pytest.param(LENGTH.pack(1025, 0), "1025 B; 1024 B is the largest", id="large"),
        pytest.param(LENGTH.pack(8, 0) + bytes(8), "cut short", id="short"),
        pytest.param(said(b"\x07", FrameKind.HELLO), "version 7", id="newer"),
        pytest.param(said(bytes([VERSION]), FrameKind.MESSAGE), "MESSAGE", id="kind"),
    ],
)
def test_nonsense_is_told_and_logged_and_harms_nobody(
    wire: Wire, data: bytes, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    wire.server().open("echo", Receiver())
    with come(wire) as stranger:
        stranger.sendall(data)
        told = frame.parse(everything(stranger)[LENGTH.size :])
    assert told.kind is FrameKind.ERROR
    assert why in told.value(TEXT)
    assert "a connection from 127.0.0.1 is refused" in caplog.text
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"


@plain_remote
def test_of_many_that_are_refused_one_is_logged_now_and_then(
    wire: Wire, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused() -> list[str]:
        for _ in range(20):
            with come(wire) as stranger:
                stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
                everything(stranger)
        return [said for said in caplog.messages if "from 127.0.0.1 is refused" in said]

    wire.server()
    assert len(refused()) == 1
    monkeypatch.setattr(errors, "AGAIN", 0.0)
    assert refused()[1].endswith(" (19 more like it since the last)")


@plain_remote
def test_a_name_may_come_in_pieces(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    name = b"".join(frame.segments(TEXT, "there", FrameKind.HELLO))
    with come(wire) as arrival:
        for byte in LENGTH.pack(len(name), 0) + name:
            arrival.sendall(bytes([byte]))
        connection = Connection(arrival)
        connection.send(frame.segments(TEXT, "echo", FrameKind.HELLO))
        assert connection.receive().kind is FrameKind.HELLO


@remote
def test_whoever_says_nothing_is_let_go(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "SAY_LIMIT", 0.02)
    with come(wire) as silent:
        assert everything(silent) == b""


@remote
def test_a_crowd_that_says_nothing_keeps_nobody_out_for_long(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "SAY_LIMIT", 0.05)
    for _ in range(gateway_module.MOST - 3):
        wire.gateway._room.acquire()
    wire.server().open("echo", Receiver())
    crowd = [come(wire) for _ in range(10)]
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"
    for each in crowd:
        each.close()


@remote
def test_a_container_that_takes_nobody_in_keeps_nobody_waiting_for_long(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_LIMIT", 0.05)
    path = gateway_path(wire.folder, "there")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stuck:
        stuck.bind(str(path))
        fill(path)
        with pytest.raises(Unavailable, match=r"'there' accepted no connection within"):
            wire.channel().request(call("?"), LIMIT)


@remote
def test_many_may_come_at_once(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    """Far more than the kernel holds for a container that has not looked yet."""
    # a busy machine takes its time for so many handshakes
    for module in opening, connection_server:
        monkeypatch.setattr(module, "ANSWER_LIMIT", LIMIT)
    wire.server().open("echo", Receiver())
    channels = [wire.channel() for _ in range(60)]
    with ThreadPoolExecutor(60) as callers:
        answers = callers.map(
            lambda channel: channel.request(call("ab"), LIMIT), channels
        )
        assert {answer.value(TEXT) for answer in answers} == {"ba"}


def fill(path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                sender.sendto(b"+", str(path))


@remote
def test_a_container_that_is_started_anew_is_reached_where_it_was(wire: Wire) -> None:
    channel = wire.channel()
    for _ in range(2):
        server = wire.server()
        server.open("echo", Receiver())
        wait_until(channel.try_connect)
        assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
        server.close()
        wait_until(lambda: not channel.try_connect())


@remote
def test_what_was_handed_on_stays_when_the_door_closes(wire: Wire) -> None:
    wire.server().open("echo", Receiver())
    channel = wire.channel()
    channel.request(call("a"), LIMIT)
    wire.gateway.close()
    assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
    other = wire.channel()
    with pytest.raises(Unavailable, match=r"nothing listens at 127\.0\.0\.1:"):
        other.request(call("?"), LIMIT)


@remote
def test_no_file_stays_open_of_those_who_came(wire: Wire) -> None:
    def files() -> int:
        return len([*Path("/proc/self/fd").iterdir()])

    wire.server().open("echo", Receiver())
    before = files()
    for said in (b"\xff" * 8, b""):
        with come(wire) as stranger:
            stranger.sendall(said)
    channel = wire.channel()
    channel.request(call("a"), LIMIT)
    channel.close()
    wait_until(lambda: files() <= before)  # earlier tests may close some


@pytest.fixture
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def test_two_computers_on_one_machine_have_gateways_of_their_own(folder: Path) -> None:
    with Gateway(folder, ANYBODY) as one, Gateway(folder, ANYBODY) as other:
        assert str(one) != str(other)


def test_it_comes_in_by_ipv6_too(folder: Path) -> None:
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            pass
    except OSError:
        pytest.skip("no IPv6 here")
    server = ConnectionServer(folder, "there")
    server.open("echo", Receiver())
    with Gateway(folder, "::1") as there:
        channel = Channel("echo", Address.parse(f"{there}/there"), folder)
        assert channel.request(call("ab"), LIMIT).value(TEXT) == "ba"
        channel.close()
    server.close()


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("203.0.113.9", "Cannot assign requested address"),
        (ANYBODY, "Address already in use"),
    ],
)
def test_an_address_that_cannot_be_had_is_an_error(
    folder: Path, host: str, why: str
) -> None:
    with socket.create_server((ANYBODY, 0)) as busy:
        port = busy.getsockname()[1]
        with pytest.raises(RunError, match=f"cannot listen on {host}:{port}: {why}$"):
            Gateway(folder, host, port)


@pytest.mark.parametrize("wire", ["ipv6"], indirect=True)
def test_calls_and_messages_cross_over_ipv6(wire: Wire) -> None:
    receiver = Receiver()
    wire.server().open("echo", receiver)
    assert str(wire.gateway).startswith("[::1]:")
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"
    wire.channel(use=MESSAGES).push(message("a"), LIMIT)
    assert receiver.wait_for(1) == ["a"]


@contextlib.contextmanager
def no_file_free() -> Iterator[None]:
    """Let this process open no more files for a while, whatever others close."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (STANDARD_STREAMS, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def said_by(who: str, caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the warnings of one that accepts connections."""
    begin = f"{who} accepts no connection for now: "
    return [text for text in map(str, caplog.messages) if text.startswith(begin)]


@remote
@pytest.mark.parametrize("who", ["the gateway", "container 'there'"])
def test_says_that_no_file_is_free_and_what_to_do(
    wire: Wire, who: str, caplog: pytest.LogCaptureFixture
) -> None:
    server = wire.server()
    server.open("echo", Receiver())
    address = wire.address().gateway
    assert address is not None
    with (
        socket.socket(socket.AF_INET) as remote,
        socket.socket(socket.AF_UNIX) as local,
    ):
        with no_file_free():
            if who == "the gateway":
                remote.connect((address.host, address.port))
            else:
                local.connect(str(server._paths[0]))
            # the other one may say so too: its thread may reach `accept` only now
            wait_until(lambda: said_by(who, caplog))
        (said,) = said_by(who, caplog)
    assert "Too many open files" in said
    assert "raise that where the agent starts (`ulimit -n " in said
    assert wire.channel().request(call("ab"), LIMIT).value(TEXT) == "ba"
