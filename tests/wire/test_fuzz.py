"""Whatever bytes come from a wire: a value of the declared type, or a WireError."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from poise import Message
from poise.wire import _channel, frame
from poise.wire.codec import MALFORMED, WireError, codec
from poise.wire.frame import FrameKind
from poise.wire.records.heartbeat_records import Heartbeat
from poise.wire.records.request_records import Answer, ManagerRequest
from poise.wire.records.status_records import AgentStatus, FromContainer, ToContainer


class Scan(Message):
    """What a sensor sends."""

    name: str
    ranges: NDArray[np.float32]
    more: list[int]


SCAN = Scan(name="front", ranges=np.arange(50, dtype=np.float32), more=[1, 2, 3])
TYPES = [Scan, str, tuple[str, dict[str, Any]], FromContainer]

RECORDS = [Heartbeat, ManagerRequest, Answer, AgentStatus, FromContainer, ToContainer]


def changed(data: bytes, places: list[tuple[int, int]]) -> bytes:
    """Return data with some bytes replaced."""
    known = bytearray(data)
    for place, value in places:
        known[place % len(known)] = value
    return bytes(known)


changes = st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1)


def read(data: bytes, type_: Any) -> None:
    """Read a frame as a receiver does."""
    with contextlib.suppress(WireError):
        _channel.parse(data).value(codec(type_))


@given(st.binary(max_size=400))
@pytest.mark.parametrize("type_", TYPES)
def test_any_bytes_are_read_or_refused(type_: Any, data: bytes) -> None:
    read(data, type_)


@given(changes, st.integers(0, 400))
@pytest.mark.parametrize("type_", TYPES)
def test_frames_that_were_changed_or_cut_are_read_or_refused(
    type_: Any, places: list[tuple[int, int]], length: int
) -> None:
    whole = b"".join(map(bytes, frame.segments(codec(Scan), SCAN, FrameKind.MESSAGE)))
    read(changed(whole, places), type_)
    read(whole[:length], type_)


@given(st.binary(max_size=200), changes)
def test_records_of_the_control_plane_are_read_or_refused(
    data: bytes, places: list[tuple[int, int]]
) -> None:
    beat = Heartbeat(robot="r", sender="a", key="k", number=1, sent=0.0, heard={})
    for given_ in (data, changed(msgspec.msgpack.encode(beat), places)):
        for type_ in RECORDS:
            with contextlib.suppress(*MALFORMED):
                msgspec.msgpack.decode(given_, type=type_)
