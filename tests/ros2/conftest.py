"""Tests with real nodes of ROS 2, in processes and networks of their own."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def ros2(tmp_path: Path) -> Iterator[None]:
    """Skip where ROS 2 is not installed; what it logs and finds is the test's own."""
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed: pip install -e '.[ros2]'")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
        yield
