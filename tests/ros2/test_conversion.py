"""How messages of ROS 2 become messages of components."""

from __future__ import annotations

import enum
import importlib
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Message, Stamp
from poise.clock import SystemClock
from poise.ros2.conversion import Conversions


class Image(Message):
    """What a camera sent, without its pixels."""

    stamp: Stamp


@pytest.mark.parametrize(("seconds", "is_known"), [(0, False), (1, True)])
def test_a_stamp_of_zero_is_of_unknown_age(seconds: int, *, is_known: bool) -> None:
    from sensor_msgs.msg import Image as RosImage  # noqa: PLC0415, where it is there

    sent, clock = RosImage(), SystemClock()
    sent.header.stamp.sec = seconds
    came = Conversions(clock).of(Image, RosImage).from_ros(sent)
    assert (clock.since(came.stamp) is not None) == is_known


class Size(Message):
    """How large an image is."""

    height: int
    width: int


@pytest.mark.parametrize("number", [-1, 1 << 32])
def test_a_number_that_ros_would_cut_is_refused(number: int) -> None:
    from sensor_msgs.msg import Image as RosImage  # noqa: PLC0415, where it is there

    to_ros = Conversions(SystemClock()).of(Size, RosImage).to_ros
    assert to_ros(Size(height=0, width=(1 << 32) - 1)).width == (1 << 32) - 1
    text = f"Size.width is {number}, which does not fit into uint32"
    with pytest.raises(ValueError, match=text):
        to_ros(Size(height=0, width=number))


class Mode(enum.IntEnum):
    """A number that has names."""

    ON = 7
    WIDE = 300


class Basic(Message):
    """A byte, and a number that has names."""

    byte_value: bytes = b"a"
    uint8_value: Mode = Mode.ON


class Texts(Message):
    """A text."""

    string_value: str


class Times(Message):
    """How long something takes [s]."""

    duration_value: float


@pytest.mark.parametrize(
    ("kind", "fits", "cut", "why"),
    [
        (
            "Strings",
            Texts("\u20ac"),
            Texts("a\0b"),
            r"is .a\\x00b., which does",
        ),
        ("BasicTypes", Basic(b"a"), Basic(b"ab"), "byte_value is b'ab', which does"),
        ("BasicTypes", Basic(), Basic(b"a", Mode.WIDE), "is 300, .* into uint8"),
        ("Builtins", Times(1e9), Times(1e10), "is 10000000000, .* into int32"),
    ],
)
def test_so_is_all_else_that_it_would_cut(
    kind: str, fits: Message, cut: Message, why: str
) -> None:
    ros = getattr(importlib.import_module("test_msgs.msg"), kind)
    to_ros = Conversions(SystemClock()).of(type(fits), ros).to_ros
    to_ros(fits)
    with pytest.raises(ValueError, match=why):
        to_ros(cut)


class Camera(Message):
    """What a camera's lens does."""

    k: NDArray[np.float64]


class Listed(Message):
    """The same, as a list."""

    k: list[float]


@pytest.mark.parametrize(
    "camera", [lambda n: Camera(np.zeros(n)), lambda n: Listed([0.0] * n)]
)
def test_an_array_of_another_length_is_refused(
    camera: Callable[[int], Camera | Listed],
) -> None:
    from sensor_msgs.msg import CameraInfo  # noqa: PLC0415, where it is there

    to_ros = Conversions(SystemClock()).of(type(camera(0)), CameraInfo).to_ros
    assert len(to_ros(camera(9)).k) == 9
    for length in (8, 10):
        text = rf"k has {length} values, but is double\[9\] in ROS 2"
        with pytest.raises(ValueError, match=text):
            to_ros(camera(length))


class Ranges(Message):
    """Which numbers a parameter may have."""

    integer_range: list[Range]


class Range(Message):
    """From where to where."""

    from_value: int
    to_value: int


def test_a_list_may_be_shorter_than_its_bound() -> None:
    described = importlib.import_module("rcl_interfaces.msg").ParameterDescriptor
    to_ros = Conversions(SystemClock()).of(Ranges, described).to_ros
    assert to_ros(Ranges([])).integer_range == []
    with pytest.raises(ValueError, match="integer_range has 2 values, but is sequence"):
        to_ros(Ranges([Range(1, 2), Range(3, 4)]))
