"""Ports joined with ROS 2, both ways, and a node of rclpy at the other side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import poise
from poise.session import robot_file
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import json, os
import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from poise import Component, Message, Provided, Published, Required, Stamp
from poise import every, subscribed

class LaserScan(Message):
    stamp: Stamp
    frame_id: str
    range_max: float
    ranges: NDArray[np.float32]

class SetBool:
    def set_bool(self, data: bool) -> bool: ...

class Scanner(Component):
    scan: Published[LaserScan]
    light: Provided[SetBool]

    def configure(self) -> None:
        self.number = 0

    @every(0.02)
    def tick(self) -> None:
        self.number += 1
        ranges = np.full(1000, self.number, np.float32)
        self.scan.publish(LaserScan(self.clock.stamp(), "laser", 8.0, ranges))

    def set_bool(self, data: bool) -> bool:
        return not data

class Hearer(Component):
    far: Required[SetBool]

    @subscribed("back", keep=10)
    def take(self, message: LaserScan) -> None:
        age = self.clock.since(message.stamp)
        found = {
            "number": float(message.ranges[-1]), "frame": message.frame_id,
            "age": age.value if age else None, "length": len(message.ranges),
            "may_write": bool(message.ranges.flags.writeable),
            "answer": self.far.set_bool(True),
        }
        path = os.path.join(self.parameters["folder"], "heard")
        with open(path + ".new", "w") as file:
            json.dump(found, file)
        os.replace(path + ".new", path)

class Echo(Node):
    def __init__(self):
        from sensor_msgs.msg import LaserScan
        super().__init__("echo")
        self.back = self.create_publisher(LaserScan, "/back", qos_profile_sensor_data)
        self.create_subscription(LaserScan, "/scan", self.back.publish, 10)

def main():
    rclpy.init()
    rclpy.spin(Echo())

if __name__ == "__main__":
    main()
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  see:
    function: see
    components:
      scanner: {{implementation: "bridged_of_test:Scanner", only: [left]}}
      hearer: {{implementation: "bridged_of_test:Hearer", only: [left],
               parameters: {{folder: "{folder}"}}}}
      echo: {{ros2: {{executable: ./bridged_of_test.py}}, only: [right]}}
    connectors:
      - {{between: [scanner, echo], topic: /scan, message: 4 kB, rate: 50 Hz}}
tasks:
  work: {{actions: [{{name: work, functions: [see]}}]}}
ros2:
  bridges:
    - {{ros2: /scan, port: scanner.scan}}
    - {{ros2: /back, port: hearer.back}}
    - {{ros2: /light, port: scanner.light}}
    - {{ros2: /light, port: hearer.far, type: std_srvs/srv/SetBool}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "bridged", "bridged_of_test", CODE, FILE)


def heard(file: Path) -> dict[str, Any]:
    try:
        return dict(json.loads((file.parent / "heard").read_text()))
    except FileNotFoundError:
        return {"number": 0}


def test_messages_and_calls_cross_both_ways(file: Path) -> None:
    with poise.up(poise.load(file)) as running:
        wait_long(lambda: heard(file)["number"] > 20)
        placement = running.status().placement
        first = heard(file)
        wait_long(lambda: heard(file)["number"] > first["number"] + 20)
    assert first["frame"] == "laser"
    assert first["length"] == 1000
    assert 0 < first["age"] < LONG
    assert not first["may_write"]
    assert first["answer"] is False
    # beside the port, so that what crosses the network is ROS 2's
    assert {at for name, at in placement.items() if "-" in name} == {"left"}


KEEPING = """
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int32
from poise import Component, Message, Published, published, subscribed

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

class Number(Message):
    data: int

class Maker(Component):
    number: Published[Number] = published(latest=True)

class Taker(Component):
    def configure(self) -> None:
        self.took = []

    @subscribed("number", keep=10)
    def take(self, message: Number) -> None:
        self.took.append(message.data)
        with open(self.parameters["folder"] + "/" + self.name, "w") as file:
            file.write(str(self.took))

class Echo(Node):
    def __init__(self):
        super().__init__("echo")
        self.back = self.create_publisher(Int32, "/back", LATCHED)
        self.create_subscription(Int32, "/number", self.back.publish, LATCHED)

def main():
    rclpy.init()
    rclpy.spin(Echo())

if __name__ == "__main__":
    main()
"""
KEEPING_FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  make:
    function: make
    components:
      maker: {{implementation: "keeping_of_test:Maker"}}
      taker: {{implementation: "keeping_of_test:Taker",
              parameters: {{folder: "{folder}"}}}}
  echo:
    function: echo
    components:
      echo: {{ros2: {{executable: ./keeping_of_test.py}}, only: [left]}}
tasks:
  make: {{actions: [{{name: make, functions: [make]}}]}}
  echo: {{actions: [{{name: echo, functions: [echo]}}]}}
ros2:
  bridges:
    - {{ros2: /number, port: maker.number, type: std_msgs/msg/Int32}}
    - {{ros2: /back, port: taker.number, type: std_msgs/msg/Int32,
       durability: transient local}}
"""


def test_last_messages_cross_to_late_nodes_and_once(tmp_path: Path) -> None:
    file = written(tmp_path, "keeping", "keeping_of_test", KEEPING, KEEPING_FILE)

    def took() -> str:
        path = tmp_path / "taker"
        return path.read_text() if path.exists() else ""

    def move(running: poise.Running, component: str) -> None:
        here = running.status().placement[component]
        running.move(component, "left" if here == "right" else "right", force=True)

    with poise.up(poise.load(file), task="make") as running:
        running.component("maker").publish("number", {"data": 7}, limit=20.0)
        move(running, "maker-number-ros2")
        running.tasks.start("echo")  # its node begins after the message
        wait_long(lambda: took() == "[7]")
        move(running, "taker-number-ros2")
        running.component("maker").publish("number", {"data": 8}, limit=20.0)
        wait_long(lambda: took() == "[7, 8]")


FIBONACCI = "test_msgs/action/Fibonacci"
BOTH = f""", type: {FIBONACCI}}}
    - {{ros2: /on, port: scanner.light, type: std_srvs/srv/SetBool}}"""


@pytest.mark.parametrize(
    ("line", "other", "words"),
    [
        ("port: scanner.scan", "port: scanner.scam", "did you mean 'scan'?"),
        ("range_max: float", "range_mix: float", "LaserScan.range_mix: "),
        ("range_max: float", "range_maxi: float", "did you mean 'range_max'?"),
        ("frame_id: str", "frame_id: int", "LaserScan.frame_id: is int, but a string"),
        ("NDArray[np.float32]", "NDArray[np.float64]", "but float32 in ROS 2"),
        ("std_srvs/srv/SetBool", "std_srvs/srv/SetBoo", "did you mean 'SetBool'?"),
        ("std_srvs/srv/SetBool", "std_srv/srv/SetBool", "did you mean 'std_srvs'?"),
        ("std_srvs/srv/SetBool", "std_srvs/srv/Trigger", "no such field"),
        ("std_srvs/srv/SetBool", "std_msgs/msg/Bool", "takes no std_msgs/msg/Bool"),
        ("std_srvs/srv/SetBool", FIBONACCI, "Fibonacci_Goal has no such field"),
        ("scanner.scan}", f"scanner.scan, type: {FIBONACCI}}}", f"no {FIBONACCI}, but"),
        ("scanner.scan}", "scanner.scan, limit: 3 s}", "'/scan' has `limit`, which is"),
        ("scanner.light}", "scanner.light, depth: 3}", "`depth`, which is for topics"),
        ("scanner.light}", f"scanner.light{BOTH}", "take either services or actions"),
    ],
)
def test_a_check_says_what_does_not_fit(
    file: Path, line: str, other: str, words: str
) -> None:
    for each in (file, file.parent / "bridged_of_test.py"):
        each.write_text(each.read_text().replace(line, other))
    said = "\n".join(map(str, robot_file.check(file)))
    assert words in said
