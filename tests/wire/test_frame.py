"""Frames: what crosses a connector between containers."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.wire import frame
from poise.wire.codec import ALIGNMENT, WireError, codec
from poise.wire.frame import FrameKind

TEXT = codec(str)
LIMIT = 20.0
U16, U64 = 2**16 - 1, 2**64 - 1


def packed(
    value: object, type_: Any, kind: FrameKind = FrameKind.CALL, **head: int
) -> bytes:
    return b"".join(frame.segments(codec(type_), value, kind, **head))


@given(
    value=st.text(),
    kind=st.sampled_from(FrameKind),
    tag=st.integers(0, U16),
    number=st.integers(0, U64),
    chain=st.integers(0, U64),
)
def test_what_is_packed_is_parsed(
    value: str, kind: FrameKind, tag: int, number: int, chain: int
) -> None:
    data = packed(value, str, kind, tag=tag, number=number, chain=chain)
    got = frame.parse(data)
    assert (got.kind, got.tag, got.number, got.chain) == (kind, tag, number, chain)
    assert got.value(TEXT) == value


@given(sizes=st.lists(st.integers(0, 40), max_size=4))
def test_arrays_lie_aligned_for_any_cpu(sizes: list[int]) -> None:
    arrays = [np.arange(size, dtype=np.uint8) for size in sizes]
    data = bytearray(packed(arrays, list[np.ndarray]))
    origin = np.frombuffer(data, np.uint8).ctypes.data
    got = frame.parse(data).value(codec(list[np.ndarray]))
    for sent, received in zip(arrays, got, strict=True):
        np.testing.assert_array_equal(sent, received)
        assert not received.size or (received.ctypes.data - origin) % ALIGNMENT == 0


@given(data=st.binary(max_size=80))
def test_any_bytes_are_a_frame_or_refused(data: bytes) -> None:
    try:
        got = frame.parse(data)
    except WireError:
        return
    assert len(got.body) + len(got.buffers) <= len(data)


@pytest.mark.parametrize("kept", [0, 5, 31, -1])
def test_a_cut_frame_is_refused(kept: int) -> None:
    with pytest.raises(WireError, match="cut short"):
        frame.parse(packed("something", str)[:kept])


def sent_at(nanoseconds: int) -> bytearray:
    data = bytearray(packed("hello", str))
    data[24:32] = nanoseconds.to_bytes(8, "little")
    return data


def test_a_frame_tells_how_old_it_is() -> None:
    """Sent 5 s before it was."""
    data = sent_at(time.monotonic_ns() - 5 * 10**9)
    assert 5 <= frame.parse(data).age < 5 + LIMIT
    assert 0 <= frame.parse(packed("hello", str)).age < LIMIT


def test_a_frame_from_a_clock_that_is_ahead_is_younger_than_none() -> None:
    age = frame.parse(sent_at(U64)).age
    assert age == pytest.approx(time.monotonic() - U64 * 1e-9)


def test_another_version_of_the_protocol_is_refused() -> None:
    data = bytearray(packed("hello", str))
    data[0] = 7
    with pytest.raises(WireError, match="protocol version 7, but this is version 2"):
        frame.parse(data)


def test_an_unknown_kind_is_refused() -> None:
    data = bytearray(packed("hello", str))
    data[1] = 99
    with pytest.raises(WireError, match="unknown kind of frame: 99"):
        frame.parse(data)
