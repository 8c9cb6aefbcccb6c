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
{end}
source.wait(0.0)
source.close()
"""


LEFT = """
import gc
from poise.ros2 import ros_context
from poise.ros2.executor_source import ExecutorSource

ros_context.join({})
node = ros_context.node_of("left")
node.create_timer(0.001, print)
source = ExecutorSource(node, print)
assert source.wait(30.0)
source.close()
del source
gc.collect()
"""


@pytest.mark.slow
def test_a_callback_that_was_due_leaves_without_a_warning() -> None:
    argv = [sys.executable, "-c", LEFT]
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=LONG, check=True
    )
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize("end", ["node.destroy_node()", "ros_context.leave()"])
def test_a_node_that_was_destroyed_is_given_up(end: str) -> None:
    """Its component would look as if all were well."""
    argv = [sys.executable, "-c", DESTROYED.replace("{end}", end)]
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=LONG, check=True
    )
    said = "its ROS 2 node was destroyed (`destroy_node` or `rclpy.shutdown`)"
    assert done.stdout == f"it goes on\n{said}: no callback runs\n"
