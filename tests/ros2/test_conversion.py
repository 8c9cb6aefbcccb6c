"""How messages of ROS 2 become messages of components."""

from __future__ import annotations

import pytest

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
