"""A topic through bridges, beside rclpy alone: python -m benchmarks.ros2_bridge.

A node of rclpy publishes a message and waits until it comes back, through as many
processes each time, in turns: from a node of rclpy in a session of its own, as services
and other terminals start it; from one in the same session, whose processes the kernel
schedules as a group; and from a component of Poise, which gets and sends it through two
bridges. With --tuned the nodes of rclpy have the profile of Fast DDS and the allocation
that bridges have. Needs `poise[ros2]`.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import poise
from poise import Component, Message, Published, subscribed

WAYS = {"apart": "rclpy", "beside": "in one session", "bridged": "through bridges"}
SIZES = {64: 100, 1_000_000: 30}
"""Bytes -> how often they are sent in one round."""
ROUNDS = 8
LIMIT = 30.0
AGAIN = 5.0
"""A message without an answer is sent again after this time [s], and that is said."""
DOMAIN = str(1 + os.getpid() % 100)
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


def echo(name: str) -> None:
    """Be the node that sends back what comes."""
    import rclpy  # noqa: PLC0415, the first process needs none of it
    from sensor_msgs.msg import Image  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node(f"echo_{name}")
    back = node.create_publisher(Image, f"/{name}_back", 10)
    node.create_subscription(Image, f"/{name}", back.publish, 10)
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
        for name in WAYS:
            self._out[name] = self._node.create_publisher(Image, f"/{name}", 10)
            self._node.create_subscription(Image, f"/{name}_back", self._take, 10)

    def _take(self, message: Any) -> None:  # noqa: ANN401, of rclpy
        self._came = message.step

    def ask(self, name: str, number: int, size: int, limit: float = LIMIT) -> float:
        """Return how long a message of `size` [bytes] takes there and back [s]."""
        message = self._message(step=number)
        message.data.frombytes(bytes(size))
        began = time.monotonic()
        again_at = began
        while self._came != number:
            now = time.monotonic()
            if now > began + limit:
                raise TimeoutError(f"{name}: no answer within {limit:g} s")
            if now >= again_at:
                if again_at > began:
                    print(f"{name}: a message got no answer within {AGAIN:g} s")
                self._out[name].publish(message)
                again_at = now + AGAIN
            self._executor.spin_once(timeout_sec=0.1)
        return time.monotonic() - began

    def wait_until_there(self, name: str) -> None:
        for _ in range(round(LIMIT)):
            with suppress(TimeoutError):
                self.ask(name, 0, 64, limit=1.0)
                return
        raise TimeoutError(f"nobody answers on /{name}")


@contextmanager
def process(*argv: str, apart: bool = True) -> Iterator[None]:
    """Let a process run meanwhile."""
    started = subprocess.Popen(argv, start_new_session=apart)
    try:
        yield
    finally:
        started.terminate()
        try:
            started.wait(LIMIT)
        except subprocess.TimeoutExpired:  # rclpy may overlook a signal
            started.kill()
            started.wait()


def main(rounds: int, tuned: Sequence[str]) -> None:
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
        plain = (python, "-m", "benchmarks.ros2_bridge", *tuned, "--echo")
        with (
            process(python, *agent, *where),
            process(*plain, "apart"),
            process(*plain, "beside", apart=False),
        ):
            robot = poise.load(file)
            with poise.up(robot, say=lambda _: None):
                asker = Asker()
                for name in WAYS:
                    asker.wait_until_there(name)
                for size, count in SIZES.items():
                    compare(asker, size, count, rounds)


def compare(asker: Asker, size: int, count: int, rounds: int) -> None:
    """Print the median of each way, asked in turns."""
    times: dict[str, list[float]] = {name: [] for name in WAYS}
    number = 0
    for _ in range(rounds):
        for name, found in times.items():
            for _ in range(count):
                number += 1
                found.append(asker.ask(name, number, size))
    medians = {name: statistics.median(found) for name, found in times.items()}
    print(f"{size:,} B there and back:")
    for name, median in medians.items():
        ratio = medians["bridged"] / median
        print(f"  {WAYS[name]:>15} {median * 1e3:7.3f} ms, bridges {ratio:.2f} times")


def tune() -> None:
    """Let this process have what those with bridges have."""
    profile = files("poise") / "ros2" / "fastdds.xml"
    os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(profile)
    allocator = ctypes.CDLL(None)
    for parameter, value in ((-1, 512 << 20), (-3, 32 << 20)):
        allocator.mallopt(parameter, value)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        "python -m benchmarks.ros2_bridge", description=__doc__
    )
    parser.add_argument("--quick", action="store_true", help="one round")
    parser.add_argument("--tuned", action="store_true", help="tune rclpy, too")
    parser.add_argument("--echo", choices=WAYS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.tuned:
        tune()
    if arguments.echo:
        echo(arguments.echo)
    else:
        main(1 if arguments.quick else ROUNDS, ["--tuned"] * arguments.tuned)
