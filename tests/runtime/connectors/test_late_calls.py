"""A call is not run after its caller's limit, wherever the time went."""

from __future__ import annotations

import struct
import time
from typing import Protocol

import pytest

from poise import Component, Provided, Required
from poise.clock import Elapsed
from poise.runtime.connectors.channel_route import ChannelRoute
from poise.runtime.connectors.interface import methods
from poise.wire.frame import FAILURE, Frame, FrameKind, Pieces, segments
from tests.runtime.conftest import Pair
from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

AHEAD = 1000.0
"""How far the caller's clock is ahead where its computer is another [s]."""
_SENT = 24
"""Where a frame says when it was sent [bytes]."""


class Driving(Protocol):
    def drive(self, speed: float) -> None: ...


class Wheels(Component):
    driving: Provided[Driving]

    def configure(self) -> None:
        self.speeds: list[float] = []

    def drive(self, speed: float) -> None:
        self.speeds.append(speed)


class Pilot(Component):
    driving: Required[Driving]


(DRIVE,) = methods(Driving).values()


def call(speed: float, sent: float, limit: float) -> Pieces:
    """Return a call that was sent at `sent` [s] and has a limit [s]."""
    head, *rest = segments(
        DRIVE.arguments,
        (speed,),
        FrameKind.CALL,
        tag=DRIVE.tag,
        number=int(1e9 * limit),
    )
    changed = bytearray(head)
    struct.pack_into("<Q", changed, _SENT, int(1e9 * sent))
    return [changed, *rest]


def ask(pair: Pair, pieces: Pieces) -> Frame:
    (sender,) = (end.sender for end in pair.sides["source"].open_connectors())
    assert sender is not None
    (route,) = sender.routes().values()
    assert isinstance(route, ChannelRoute)
    return route._channel.request(pieces, LIMIT)


def join(pair: Pair) -> Wheels:
    wheels, _ = pair.run("target", Wheels), pair.run("source", Pilot)
    pair.join("driving")
    pair.activate()
    return wheels


def now(pair: Pair) -> float:
    """Return the time on the caller's clock [s]."""
    return time.monotonic() + (AHEAD if pair.kind == "remote" else 0.0)


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_call_whose_limit_passed_on_the_wire_is_not_run(pair: Pair) -> None:
    pair.clocks["source"] = Elapsed(AHEAD, 0.001)
    wheels = join(pair)
    late = call(1.0, now(pair) - 0.4, 0.2)  # "go" was under way for 0.4 s
    assert ask(pair, call(0.0, now(pair), LIMIT)).kind is FrameKind.RESULT  # "stop"
    answer = ask(pair, late)
    kind, why, _ = answer.value(FAILURE)
    assert kind == "Timeout"
    assert "'target' was not called: its caller's limit passed 0." in why
    assert wheels.speeds == [0.0]


@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_what_the_clocks_leave_open_counts_as_time_on_the_wire(pair: Pair) -> None:
    # no answer can be back in time: the quickest way back takes as long
    pair.clocks["source"] = Elapsed(AHEAD, 0.3)
    wheels = join(pair)
    assert ask(pair, call(1.0, now(pair), 0.2)).kind is FrameKind.ERROR
    assert ask(pair, call(2.0, now(pair), LIMIT)).kind is FrameKind.RESULT
    assert wheels.speeds == [2.0]


@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_a_call_over_an_unknown_clock_counts_from_its_arrival(pair: Pair) -> None:
    wheels = join(pair)
    sent = max(1.0, now(pair) - 2 * AHEAD)
    assert ask(pair, call(1.0, sent, LIMIT)).kind is FrameKind.RESULT
    assert wheels.speeds == [1.0]


@pytest.mark.parametrize("pair", ["local"], indirect=True)
def test_a_caller_of_another_time_gets_an_answer(pair: Pair) -> None:
    join(pair)
    future = call(1.0, now(pair) + AHEAD, LIMIT)
    assert ask(pair, future).kind is FrameKind.RESULT
