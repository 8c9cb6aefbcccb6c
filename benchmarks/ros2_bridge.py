"""A topic through bridges, beside rclpy alone: python -m benchmarks.ros2_bridge.

A node of rclpy publishes a message and waits until it comes back: from a second process
that is a node of rclpy, too, and from one in which a component of Poise gets and sends
it through two bridges. Both are asked in turns, in one run. Needs `poise[ros2]`.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import poise
from poise import Component, Message, Published, subscribed

SIZES = {64: 100, 1_000_000: 30}
"""Bytes -> how often they are sent in one round."""
ROUNDS = 8
LIMIT = 30.0
DOMAIN = "86"
FILE = """
robot: ros2-bridge-{pid}
computers:
  here: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:{port}"}}
architectures:
  echo:
    function: echo
    components:
      echo: {{implementation: "benchmarks.ros2_bridge:Echo"}}
tasks:
  work: {{actions: [{{name: work, functions: [echo]}}]}}
ros2:
  domain: {domain}
  discovery: localhost
  bridges:
    - {{ros2: /bridged, port: echo.came, type: sensor_msgs/msg/Image}}
    - {{ros2: /bridged_back, port: echo.back, type: sensor_msgs/msg/Image}}
"""


class Pixels(Message):
    """What is sent."""

    step: int
    data: NDArray[np.uint8]


class Echo(Component):
    """Sends back what comes."""

    back: Published[Pixels]

    @subscribed(keep=10)
    def came(self, message: Pixels) -> None:
        self.back.publish(message)


def echo() -> None:
    """Be the node that sends back what comes."""
    import rclpy  # noqa: PLC0415, the first process needs none of it
    from sensor_msgs.msg import Image  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node("plain_echo")
    back = node.create_publisher(Image, "/plain_back", 10)
    node.create_subscription(Image, "/plain", back.publish, 10)
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


class Asker:
    """Sends a message, and waits until it is back."""

    def __init__(self) -> None:
        import rclpy  # noqa: PLC0415, the same
        from sensor_msgs.msg import Image  # noqa: PLC0415

        rclpy.init()
        self._message = Image
        self._node = rclpy.create_node("asker")
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._came = -1
        self._out: dict[str, Any] = {}
        for name in ("plain", "bridged"):
            self._out[name] = self._node.create_publisher(Image, f"/{name}", 10)
            self._node.create_subscription(Image, f"/{name}_back", self._take, 10)

    def _take(self, message: Any) -> None:  # noqa: ANN401, of rclpy
        self._came = message.step

    def ask(self, name: str, number: int, size: int, limit: float = LIMIT) -> float:
        """Return how long a message of `size` [bytes] takes there and back [s]."""
        message = self._message(step=number)
        message.data.frombytes(bytes(size))
        until = time.monotonic() + limit
        began = time.perf_counter()
        self._out[name].publish(message)
        while self._came != number:
            self._executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > until:
                raise TimeoutError(f"{name}: no answer within {limit:g} s")
        return time.perf_counter() - began

    def wait_until_there(self, name: str) -> None:
        for _ in range(round(LIMIT)):
            with suppress(TimeoutError):
                self.ask(name, 0, 64, limit=1.0)
                return
        raise TimeoutError(f"nobody answers on /{name}")


@contextmanager
def process(*argv: str) -> Iterator[None]:
    """Let a process run meanwhile."""
    with subprocess.Popen(argv) as started:
        try:
            yield
        finally:
            started.terminate()


def main(rounds: int) -> None:
    """Print the times and their ratio."""
    os.environ["ROS_DOMAIN_ID"] = DOMAIN
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["PYTHONPATH"] = str(Path(__file__).parents[1])  # containers import it
    python, port = sys.executable, 20_000 + os.getpid() % 10_000
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.yaml")
        file.write_text(FILE.format(pid=os.getpid(), port=port, domain=DOMAIN))
        agent = (
            "-m",
            "poise",
            "agent",
            "here",
            "--robot",
            f"ros2-bridge-{os.getpid()}",
        )
        where = ("--address", "127.0.0.1", "--port", str(port), "--folder", folder)
        plain = (python, "-m", "benchmarks.ros2_bridge", "echo")
        with process(python, *agent, *where), process(*plain):
            robot = poise.load(file)
            with poise.up(robot, say=lambda _: None):
                asker = Asker()
                for name in ("plain", "bridged"):
                    asker.wait_until_there(name)
                for size, count in SIZES.items():
                    compare(asker, size, count, rounds)


def compare(asker: Asker, size: int, count: int, rounds: int) -> None:
    """Print the median of each way, asked in turns."""
    times: dict[str, list[float]] = {"plain": [], "bridged": []}
    number = 0
    for _ in range(rounds):
        for name, found in times.items():
            for _ in range(count):
                number += 1
                found.append(asker.ask(name, number, size))
    plain, bridged = (statistics.median(found) for found in times.values())
    print(
        f"{size:>9,} B there and back: rclpy {plain * 1e3:.3f} ms, through bridges "
        f"{bridged * 1e3:.3f} ms: {bridged / plain:.2f} times"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        "python -m benchmarks.ros2_bridge", description=__doc__
    )
    parser.add_argument("--quick", action="store_true", help="one round")
    parser.add_argument("who", nargs="?", choices=["echo"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.who:
        echo()
    else:
        main(1 if arguments.quick else ROUNDS)
