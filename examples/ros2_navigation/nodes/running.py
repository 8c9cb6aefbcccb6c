"""What the `main` of each node does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


def run(make: Callable[[], Node]) -> None:
    """Spin one node until it is told to end; a lifecycle node is activated."""
    rclpy.init()
    try:
        node: Any = make()
        if hasattr(node, "trigger_configure"):
            node.trigger_configure()
            node.trigger_activate()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


def pose(stamp: Any, x: float, y: float, heading: float) -> PoseStamped:  # noqa: ANN401
    """Return a pose in the map; `z` holds the heading [rad], as all is flat."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp, "map"
    message.pose.position.x, message.pose.position.y = float(x), float(y)
    message.pose.position.z = float(heading)
    return message
