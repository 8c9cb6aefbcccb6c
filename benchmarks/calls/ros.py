"""What the cases with rclpy share."""

from __future__ import annotations

import os
from typing import Any

import rclpy


def start(name: str) -> Any:
    """Return a node that talks to this computer only."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = "87"
    rclpy.init()
    return rclpy.create_node(name)
