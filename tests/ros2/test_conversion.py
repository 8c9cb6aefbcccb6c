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
