"""Frames to send, a handler that answers them, and channels of every kind."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from poise.session.keys import init_keys
from poise.wire import frame
from poise.wire.address import KEYS, Address
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.connections.gateway import Gateway
from poise.wire.connections.opening import CALLS, renewable_keys
from poise.wire.frame import Frame, FrameKind, Pieces
from tests.waiting import LIMIT

TEXT = codec(str)
SHORT = 0.02
"""For what must run into its limit [s]."""


def call(text: str) -> Pieces:
    return frame.segments(TEXT, text, FrameKind.CALL)


def message(text: str) -> Pieces:
    return frame.segments(TEXT, text, FrameKind.MESSAGE)


class Receiver:
    """Answers calls with what they say, backwards, and keeps messages."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.came = threading.Condition()

    def __call__(self, received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        if received.kind is FrameKind.CALL:
            return frame.segments(TEXT, text[::-1], FrameKind.RESULT)
        with self.came:
            self.messages.append(text)
            self.came.notify_all()
        return None

    def wait_for(self, count: int) -> list[str]:
        with self.came:
            assert self.came.wait_for(lambda: len(self.messages) >= count, LIMIT)
            return self.messages


@contextlib.contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    os.environ[name] = value
    renewable_keys.cache_clear()
    try:
        yield
    finally:
        del os.environ[name]
        renewable_keys.cache_clear()


class Wire:
    """Containers of one computer, or of two with a gateway between them."""

    def __init__(self, kind: str, folder: Path, closing: ExitStack) -> None:
        self.kind = kind
        self.folder = folder
        self.closing = closing
        if kind == "tls":
            place = Path(closing.enter_context(tempfile.TemporaryDirectory()))
            self.authority = init_keys("test", place / "owner")
            keys = self.authority.issue("a", "agent", place / "a")
            closing.enter_context(_environment(KEYS, str(keys.folder)))
        if kind != "local":
            host = "::1" if kind == "ipv6" else "127.0.0.1"
            self.gateway = closing.enter_context(Gateway(folder, host))

    def address(self, container: str = "there") -> Address:
        gateway = "" if self.kind == "local" else f"{self.gateway}/"
        return Address.parse(f"{gateway}{container}")

    def server(self) -> ConnectionServer:
        server = ConnectionServer(self.folder, "there")
        self.closing.callback(server.close)
        return server

    def channel(
        self,
        connector: str = "echo",
        use: int = CALLS,
        on_frame: Callable[[Frame], bool] | None = None,
        first: Callable[[], Pieces] | None = None,
    ) -> Channel:
        address = self.address()
        channel = Channel(connector, address, self.folder, use, on_frame, first)
        self.closing.callback(channel.close)
        return channel


@pytest.fixture
def wire(request: pytest.FixtureRequest) -> Iterator[Wire]:
    with tempfile.TemporaryDirectory() as folder, ExitStack() as closing:
        yield Wire(request.param, Path(folder), closing)


both = pytest.mark.parametrize("wire", ["local", "remote", "tls"], indirect=True)
remote = pytest.mark.parametrize("wire", ["remote", "tls"], indirect=True)
encrypted = pytest.mark.parametrize("wire", ["tls"], indirect=True)
plain = pytest.mark.parametrize("wire", ["local", "remote"], indirect=True)
plain_remote = pytest.mark.parametrize("wire", ["remote"], indirect=True)
"""For tests that speak with raw sockets."""
