"""ROS 2: a topic in each direction."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from std_msgs.msg import UInt8MultiArray

from benchmarks.calls.ros import start
from benchmarks.calls.timing import Trips, payload, read, timed


def serve(_folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    node = start("server")
    pong = node.create_publisher(UInt8MultiArray, "pong", 10)
    node.create_subscription(UInt8MultiArray, "ping", pong.publish, 10)
    ready()
    rclpy.spin(node)


@contextmanager
def connect(_folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    node = start("client")
    came: list[Any] = []
    ping = node.create_publisher(UInt8MultiArray, "ping", 10)
    node.create_subscription(UInt8MultiArray, "pong", came.append, 10)
    end = time.monotonic() + 20
    while not (ping.get_subscription_count() and node.count_publishers("pong")):
        assert time.monotonic() < end, "the server was not found"
        time.sleep(0.02)
    time.sleep(0.5)  # discovery is done on both sides only a little later

    def echo(message: Any) -> None:
        came.clear()
        ping.publish(message)
        while not came:
            rclpy.spin_once(node)
        read(came[0].data)

    def trips(size: int, count: int) -> list[float]:
        return timed(echo, UInt8MultiArray(data=array("B", payload(size))), count)

    yield trips
