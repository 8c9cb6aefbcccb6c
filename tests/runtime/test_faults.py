"""What comes over a connector and is not what its port takes; the receiver lives on."""

from __future__ import annotations

import asyncio
import struct
import sys
from typing import Any, Protocol

import pytest

from poise import Component, Message, Provided, Published, Required, subscribed
from poise.errors import CalleeError, CannotCross
from poise.runtime.connectors.channel_route import ChannelRoute
from poise.runtime.connectors.interface import message_tag, methods
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel
from poise.wire.frame import FAILURE, LARGEST, FrameKind, Pieces, segments
from tests.waiting import LIMIT, wait_until

from .conftest import Pair, every_kind

pytestmark = pytest.mark.slow

wired = pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)


class Pose(Message):
    x: float


class Doubling(Protocol):
    def double(self, number: int) -> int: ...

    def zeros(self, size: int) -> bytes: ...

    def leave(self) -> None: ...

    def cancel(self) -> None: ...

    def fail_to_say(self) -> None: ...


class Unsayable(Exception):
    def __str__(self) -> str:
        raise LookupError("nothing to say")


class Target(Component):
    doubling: Provided[Doubling]

    def configure(self) -> None:
        self.heard: list[float] = []

    def double(self, number: int) -> int:
        return 2 * number

    def zeros(self, size: int) -> bytes:
        return bytes(size)

    def leave(self) -> None:
        sys.exit("bye")

    def cancel(self) -> None:
        raise asyncio.CancelledError

    def fail_to_say(self) -> None:
        raise Unsayable

    @subscribed(block=4)
    def pose(self, message: Pose) -> None:
        self.heard.append(message.x)


class Source(Component):
    doubling: Required[Doubling]
    pose: Published[Pose]


CALL, MESSAGE = "source.doubling-target.doubling", "source.pose-target.pose"
DOUBLE = next(tag for tag, m in methods(Doubling).items() if m.name == "double")


@pytest.fixture
def ends(pair: Pair) -> tuple[Source, Target]:
    target, source = pair.run("target", Target), pair.run("source", Source)
    pair.join("doubling")
    pair.join("pose")
    pair.activate()
    return source, target


def pipe_of(pair: Pair, connector: str) -> Channel:
    (path,) = pair.sides["source"].sender(connector).routes().values()
    assert isinstance(path, ChannelRoute)
    return path._channel


def refusals(pair: Pair, connector: str) -> int:
    (end,) = (e for e in pair.sides["target"].status() if e.name == connector)
    return end.errors


def frame(kind: FrameKind, tag: int, value: Any) -> Pieces:
    return segments(codec(Any), value, kind, tag=tag, chain=1)


def changed(pieces: Pieces, at: int, form: str, value: int) -> Pieces:
    """Write another number into a frame's head."""
    head = bytearray(pieces[0])
    struct.pack_into(form, head, at, value)
    return [bytes(head), *pieces[1:]]


GOOD = frame(FrameKind.CALL, DOUBLE, (1,))
BAD_CALLS = [
    pytest.param(frame(FrameKind.CALL, DOUBLE, ("one",)), "Expected `int`", id="type"),
    pytest.param(
        frame(FrameKind.CALL, DOUBLE ^ 1, (1,)), "different versions", id="tag"
    ),
    pytest.param(frame(FrameKind.CALL, DOUBLE, (1, 2)), "length", id="one too many"),
    pytest.param(changed(GOOD, 0, "<B", 7), "protocol version 7", id="newer version"),
    pytest.param(changed(GOOD, 1, "<B", 99), "unknown kind", id="kind"),
    pytest.param(changed(GOOD, 4, "<I", 99), "cut short", id="truncated"),
]


@wired
@pytest.mark.parametrize(("pieces", "why"), BAD_CALLS)
def test_a_call_that_cannot_be_read_is_refused(
    pair: Pair,
    ends: tuple[Source, Target],
    pieces: Pieces,
    why: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    answer = pipe_of(pair, CALL).request(pieces, LIMIT)
    assert answer.kind is FrameKind.ERROR
    name, text, traceback = answer.value(FAILURE)
    assert (name, traceback) == ("WireError", "")
    assert why in text
    assert refusals(pair, CALL) == 1
    wait_until(lambda: f"connector {CALL}" in caplog.text)
    assert why in caplog.text
    assert ends[0].doubling.double(21) == 42


POSE = message_tag(Pose)
GOOD_MESSAGE = frame(FrameKind.MESSAGE, POSE, {"x": 1.0})
BAD_MESSAGES = [
    pytest.param(frame(FrameKind.MESSAGE, POSE, {"x": "here"}), "`float`", id="type"),
    pytest.param(frame(FrameKind.MESSAGE, POSE ^ 2, {"x": 1.0}), "versions", id="tag"),
    pytest.param(changed(GOOD_MESSAGE, 0, "<B", 7), "version 7", id="newer version"),
    pytest.param(changed(GOOD_MESSAGE, 4, "<I", 99), "cut short", id="truncated"),
]


@wired
@pytest.mark.parametrize(("pieces", "why"), BAD_MESSAGES)
def test_a_message_that_cannot_be_read_is_refused(
    pair: Pair,
    ends: tuple[Source, Target],
    pieces: Pieces,
    why: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    source, target = ends
    source.pose.publish(Pose(1.0))
    pipe_of(pair, MESSAGE).push(pieces, LIMIT)
    wait_until(lambda: refusals(pair, MESSAGE) == 1)
    wait_until(lambda: f"connector {MESSAGE}" in caplog.text)
    assert why in caplog.text
    source.pose.publish(Pose(2.0))
    wait_until(lambda: target.heard == [1.0, 2.0])


@wired
def test_a_frame_that_is_too_large_is_refused(
    pair: Pair, ends: tuple[Source, Target], caplog: pytest.LogCaptureFixture
) -> None:
    assert ends[0].doubling.double(1) == 2
    connection = next(iter(pipe_of(pair, CALL)._calls))
    connection._connection.sendall(struct.pack("<II", LARGEST + 1, 0))
    wait_until(lambda: refusals(pair, CALL) == 1)
    wait_until(lambda: f"connector {CALL}" in caplog.text)
    assert "1073741825 B; 1073741824 B is the largest" in caplog.text
    wait_until(lambda: not connection.is_idle())  # why it was refused has come
    connection.end()
    assert ends[0].doubling.double(21) == 42


@wired
def test_an_answer_that_is_too_large_is_the_callers_error(
    ends: tuple[Source, Target], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.wire.connections.connection.LARGEST", 1000)
    with pytest.raises(CannotCross, match="1000 B is the largest"):
        ends[0].doubling.zeros(1000)
    assert ends[0].doubling.double(21) == 42


@every_kind
@pytest.mark.usefixtures("pair")
@pytest.mark.parametrize(
    ("method", "type_name", "message"),
    [
        ("leave", "SystemExit", "bye"),
        ("cancel", "CancelledError", ""),
        ("fail_to_say", "Unsayable", r"<str\(\) of a Unsayable failed>"),
    ],
)
def test_whatever_a_callee_raises_is_an_error_of_its_caller(
    ends: tuple[Source, Target], method: str, type_name: str, message: str
) -> None:
    """Else the thread of a connection ends without a word."""
    with pytest.raises(CalleeError, match=f"{type_name}: {message}") as caught:
        getattr(ends[0].doubling, method)()
    assert caught.value.type_name == type_name
    assert ends[0].doubling.double(21) == 42
