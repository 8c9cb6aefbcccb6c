"""`poise ros2 import` on real nodes in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.model import load
from poise.model.robot import Robot
from tests.waiting import LONG

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

NODES = """
import sys
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

class Lidar(Node):
    def __init__(self):
        super().__init__("lidar")
        self.scans = self.create_publisher(LaserScan, "scan", 10)
        self.client = self.create_client(Trigger, "reset")
        self.create_timer(0.05, self.tick)

    def tick(self):
        scan = LaserScan(ranges=[1.0] * 100)
        scan.header.stamp = self.get_clock().now().to_msg()
        self.scans.publish(scan)

class Filter(Node):
    def __init__(self):
        super().__init__("filter", namespace="/front")
        self.scans = self.create_publisher(LaserScan, "filtered", 10)
        self.create_subscription(LaserScan, "/scan", self.scans.publish, 10)
        self.create_service(Trigger, "/reset", lambda request, response: response)

class Sink(Node):
    def __init__(self, name="sink"):
        super().__init__(name)
        self.create_subscription(LaserScan, "front/filtered", lambda scan: None, 10)

rclpy.init()
if sys.argv[1] == "both":
    executor = rclpy.executors.SingleThreadedExecutor()
    for node in (Sink("one"), Sink("two")):
        executor.add_node(node)
    executor.spin()
else:
    rclpy.spin({"lidar": Lidar, "filter": Filter}[sys.argv[1]]())
"""


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    """Import three processes with four nodes."""
    (tmp_path / "nodes.py").write_text(NODES)
    lines = ("lidar --ros-args -r __node:=front_lidar", "filter", "both")
    nodes = [
        subprocess.Popen(
            [sys.executable, "nodes.py", *line.split()],
            cwd=tmp_path,
            env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            stderr=subprocess.DEVNULL,
        )
        for line in lines
    ]
    words = [sys.executable, "-m", "poise", "ros2", "import", "--for", "6s"]
    try:
        subprocess.run(
            words,
            cwd=tmp_path,
            env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            timeout=60,
            check=True,
        )
        yield load(tmp_path / "robot.yaml")
    finally:
        for node in nodes:  # rclpy may hang when it is asked to end
            node.kill()
        for node in nodes:
            node.wait(10)


def test_a_running_graph_becomes_a_robot_that_can_be_started(robot: Robot) -> None:
    lidar = robot.component("front_lidar")
    arguments = ("lidar", "--ros-args", "-r", "__node:=front_lidar")
    assert lidar.command == ("python", "./nodes.py", *arguments)
    assert lidar.demand["cpu"] > 0
    assert lidar.demand["memory"] > 20e6
    names = {component.name for component in robot.components()}
    assert names == {"front_lidar", "front_filter", "nodes"}  # `nodes` has two
    found = {str(each): each for each in robot.all_connectors()}
    assert found.keys() == {
        "front_lidar-front_filter /scan",
        "front_lidar-front_filter /reset",
        "front_filter-nodes /front/filtered",
    }
    scan = found["front_lidar-front_filter /scan"]
    assert scan.rate == pytest.approx(20, rel=0.2)
    assert scan.message == pytest.approx(460, abs=40)  # 100 ranges of 4 bytes
    text = Path(robot.folder, "robot.yaml").read_text()
    assert "# /one, /two: one process, measured and placed as one" in text
    assert "through: [front_lidar, front_filter, nodes]" in text


def test_says_where_no_node_is_found(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "poise", "ros2", "import", "--for", "1s"]
    done = subprocess.run(
        words,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        check=False,
    )
    assert done.returncode == 1
    domain = os.environ["ROS_DOMAIN_ID"]
    assert f"no ROS 2 node was found within 6 s in domain {domain}" in done.stderr
    assert not (tmp_path / "robot.yaml").exists()
