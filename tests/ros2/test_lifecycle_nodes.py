"""What is said of a lifecycle node whose transition fails."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LONG

FAILS = """
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from poise.clock import SystemClock
from poise.model.ros2_node import START
from poise.ros2.node import RosNode
from poise.runtime.component.component import Context, create

class Camera(LifecycleNode):
    def __init__(self):
        super().__init__("camera")

    def on_configure(self, state):
        {does}

class Component(RosNode):
    make = Camera

start = {{"node": "cameras:Camera", "arguments": [], "environment": {{}}}}
context = Context(
    name="camera", parameters={{START: start}}, devices={{}}, clock=SystemClock(),
    measure=print,
)
made = create(Component, context)
try:
    made.configure()
except Exception as error:
    print(repr(error))
made.cleanup()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("raise ValueError('no lens')", "ValueError('no lens')"),
        (
            "return TransitionCallbackReturn.FAILURE",
            'RobotError("the lifecycle node\'s on_configure returned FAILURE")',
        ),
    ],
)
def test_only_what_failed_is_said(does: str, said: str) -> None:
    argv = [sys.executable, "-c", FAILS.format(does=does)]
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=LONG, check=True
    )
    assert (done.stdout, done.stderr) == (said + "\n", "")
