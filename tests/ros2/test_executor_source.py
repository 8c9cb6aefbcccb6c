"""Where the callbacks of a node come from."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LONG

DESTROYED = """
from poise.ros2 import ros_context
from poise.ros2.executor_source import ExecutorSource

ros_context.join({})
node = ros_context.node_of("short_lived")
source = ExecutorSource(node, print)
source.wait(0.0)
print("it goes on", flush=True)
node.destroy_node()
source.wait(0.0)
source.close()
ros_context.leave()
"""


@pytest.mark.slow
def test_a_node_that_was_destroyed_is_given_up() -> None:
    """Its component would look as if all were well."""
    argv = [sys.executable, "-c", DESTROYED]
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=LONG, check=True
    )
    assert done.stdout.splitlines() == [
        "it goes on",
        "its ROS 2 node was destroyed (`destroy_node`): no callback runs",
    ]
