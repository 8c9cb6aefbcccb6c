"""Who does not belong to the robot comes to a container by way of its gateway."""

from __future__ import annotations

import socket
import ssl
import struct
import time
from pathlib import Path

import pytest

from poise.errors import Unavailable
from poise.session.keys import init_keys
from poise.wire import frame
from poise.wire.connections import opening
from poise.wire.connections.connection import Connection
from poise.wire.connections.opening import NAME
from poise.wire.credentials import CERTIFICATE, PRIVATE_KEY, Credentials
from poise.wire.frame import LENGTH, FrameKind
from tests.waiting import LIMIT, wait_until
from tests.wire.conftest import Receiver, Wire, call, encrypted

pytestmark = pytest.mark.slow


def hello(name: str) -> bytes:
    text = b"".join(map(bytes, frame.segments(NAME, name, FrameKind.HELLO)))
    return LENGTH.pack(len(text), 0) + text


def is_answered(wire: Wire, context: ssl.SSLContext) -> bool:
    """Return whether somebody gets through to a connector."""
    gateway = wire.address().gateway
    assert gateway is not None
    with socket.create_connection((gateway.host, gateway.port), LIMIT) as plain:
        plain.sendall(hello("there"))
        try:
            with context.wrap_socket(plain) as secured:
                secured.sendall(hello("echo"))
                return bool(secured.recv(1))
        except (ssl.SSLError, ConnectionError):
            return False


def context_of(keys: Credentials | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if keys is not None:
        context.load_cert_chain(keys.folder / CERTIFICATE, keys.folder / PRIVATE_KEY)
    return context


@encrypted
def test_another_computer_of_the_robot_is_answered(wire: Wire, tmp_path: Path) -> None:
    wire.server().open("echo", Receiver())
    assert is_answered(wire, context_of(wire.authority.issue("b", "agent", tmp_path)))


@encrypted
@pytest.mark.parametrize(
    ("role", "days", "why"),
    [
        pytest.param("manager", 1.0, "of the role 'manager'", id="manager"),
        pytest.param("viewer", 1.0, "of the role 'viewer'", id="viewer"),
        pytest.param("agent", -0.01, "certificate has expired", id="late"),
    ],
)
def test_other_roles_and_late_keys_are_refused(
    wire: Wire,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    role: str,
    days: float,
    why: str,
) -> None:
    wire.server().open("echo", Receiver())
    keys = wire.authority.issue("b", role, tmp_path, days=days)  # type: ignore[arg-type]
    assert not is_answered(wire, context_of(keys))
    wait_until(lambda: why in caplog.text)
    assert "container 'there': another computer is refused" in caplog.text
    assert wire.channel().request(call("ab"), LIMIT).value(NAME) == "ba"


@encrypted
def test_a_channel_says_why_another_computer_refuses_it(
    wire: Wire, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of keys that do not fit, people were told to look at the firewall."""
    wire.server().open("echo", Receiver())
    other = init_keys("test", tmp_path / "other")
    keys = other.issue("b", "agent", tmp_path / "b")
    channel = wire.channel()
    with monkeypatch.context() as patch:
        patch.setattr(opening, "own_keys", lambda: keys)
        wait_until(lambda: channel.try_connect() or channel.refusal)
        assert "CERTIFICATE_VERIFY_FAILED" in channel.refusal
    wait_until(channel.try_connect)
    assert not channel.refusal


@encrypted
def test_who_has_no_keys_of_the_robot_is_refused(wire: Wire, tmp_path: Path) -> None:
    wire.server().open("echo", Receiver())
    other = init_keys("test", tmp_path / "other")
    forged = other.issue("a", "agent", tmp_path / "forged")
    assert not is_answered(wire, context_of(forged))
    assert not is_answered(wire, context_of(None))
    older = context_of(wire.authority.issue("b", "agent", tmp_path / "b"))
    older.maximum_version = ssl.TLSVersion.TLSv1_2
    assert not is_answered(wire, older)
    assert wire.channel().request(call("ab"), LIMIT).value(NAME) == "ba"


@pytest.mark.parametrize("sent", [b"", b"said before"])
def test_who_is_gone_before_the_handshake_is_unavailable(
    sent: bytes, tmp_path: Path
) -> None:
    keys = init_keys("r", tmp_path / "owner").issue("b", "agent", tmp_path / "b")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        stranger = socket.create_connection(listening.getsockname(), LIMIT)
        connection = Connection(listening.accept()[0])
        stranger.sendall(sent)
        linger = struct.pack("ii", 1, 0)  # to close it resets it
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        stranger.close()
        with pytest.raises(Unavailable, match="no TLS session"):
            connection.accept_tls(keys, time.monotonic() + LIMIT)
        connection.close()
