from __future__ import annotations

import datetime as dt
import enum
import random
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Message, Stamp
from poise.errors import UsageError
from poise.runtime.replay import maker
from poise.wire.codec import codec


class Colour(enum.Enum):
    RED = 1


class Point(Message):
    x: float
    y: float


class Seen(Message):
    stamp: Stamp
    where: Point
    colour: Colour
    kind: Literal["wall", "door"]
    count: int
    sure: bool
    more: dict[str, int]
    note: str | None
    pixels: NDArray[np.uint8]
    corners: list[Point]


class Sound(Message):
    samples: NDArray[np.float32]


class Words(Message, kw_only=True):
    text: str


class Numbers(Message):
    values: list[float]
    ranges: tuple[int, int]


class Odd(Message):
    inside: dt.datetime


def size(value: Message) -> int:
    body, buffers = codec(type(value)).encode(value)
    return len(body) + sum(buffer.nbytes for buffer in buffers)


def make(type_: type, bytes_: float, seed: int = 0) -> Any:
    return maker(type_)(random.Random(seed), bytes_)


@pytest.mark.parametrize("type_", [Seen, Sound, Words, Numbers])
@pytest.mark.parametrize("bytes_", [200, 5_000, 60_000])
def test_is_as_large_as_it_should_be(type_: type, bytes_: int) -> None:
    """To an element of a list, 9 bytes, and what the lengths themselves take."""
    assert size(make(type_, bytes_)) == pytest.approx(bytes_, abs=16)


@pytest.mark.parametrize("type_", [Seen, Sound, Words, Numbers, Point])
def test_what_is_made_up_crosses_a_wire(type_: type) -> None:
    body, buffers = codec(type_).encode(make(type_, 300))
    padded = [bytes(each) + bytes(-each.nbytes % 16) for each in buffers]
    data = memoryview(b"".join(padded))
    assert isinstance(codec(type_).decode(body, data), type_)


def test_without_a_field_of_any_length_it_is_as_large_as_it_is() -> None:
    assert size(make(Point, 5_000)) == size(Point(0.5, 0.5))


def test_the_same_seed_makes_the_same() -> None:
    assert make(Point, 0, seed=1) == make(Point, 0, seed=1)
    assert make(Point, 0, seed=1) != make(Point, 0, seed=2)


def test_an_array_holds_finite_numbers() -> None:
    samples = make(Sound, 1000).samples
    assert samples.dtype == np.float32
    assert np.isfinite(samples).all()


class Branch(Message):
    twig: Branch | None = None


def test_says_so_of_a_message_that_has_itself_inside() -> None:
    with pytest.raises(UsageError, match=r"for Branch .*itself inside.* `message`"):
        maker(Branch)


def test_says_what_nothing_can_be_made_up_for() -> None:
    with pytest.raises(UsageError, match=r"Odd\.inside .*datetime.* `message`"):
        maker(Odd)
