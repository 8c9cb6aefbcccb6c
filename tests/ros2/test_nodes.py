"""Nodes of ROS 2 as components: between computers, measured, moved, restarted."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

import poise
from poise.errors import UsageError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.migration_report import MigrationReport
from poise.wire.records.status_records import ComponentStatus
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

NODES = """
import json, os, sys
import rclpy
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from std_msgs.msg import Int32

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.declare_parameter("period", 1.0)
        self.count = 0
        self.counts = self.create_publisher(Int32, "count", 10)
        self.create_timer(self.get_parameter("period").value, self.tick)

    def tick(self):
        self.count += 1
        self.counts.publish(Int32(data=self.count))

    def snapshot(self):
        return {"count": self.count}

    def restore(self, state):
        self.count = state["count"]

class Listener(Node):
    def __init__(self):
        super().__init__("listener")
        self.declare_parameter("folder", "")
        self.folder = self.get_parameter("folder").value
        self.create_subscription(Int32, "/heard", self.take, 10)

    def take(self, message):
        write(self, data=message.data)
        # the first numbers may pass before this node was found
        if self.get_name() == "ear" and message.data % 10 == 5:
            raise ValueError("five is wrong")

class Managed(LifecycleNode):
    def __init__(self):
        super().__init__("managed")
        self.did = []

    def note(self, what):
        self.did.append(what)
        write(self, did=self.did, pid=os.getpid())
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state):
        self.declare_parameter("folder", "")
        self.folder = self.get_parameter("folder").value
        return self.note("configure")

    def on_activate(self, state):
        return self.note("activate")

    def on_deactivate(self, state):
        return self.note("deactivate")

    def on_cleanup(self, state):
        return self.note("cleanup")

def write(node, **what):
    path = f"{node.folder}/{node.get_name()}"
    if "pid" in what:
        path += f"-{what['pid']}"
    with open(path + ".new", "w") as file:
        json.dump(what, file)
    os.replace(path + ".new", path)

if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Listener())
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  speak:
    function: speak
    components:
      talker: {{ros2: {{node: "nodes_of_test:Talker", remap: {{count: /heard}},
                       params: {{period: 0.02}}}}, cpu: 5%}}
      ear: {{ros2: {{node: "nodes_of_test:Listener", name: ear, namespace: /side,
                    params: {{folder: "{folder}"}}}}, cpu: 5%}}
      other: {{ros2: {{executable: ./nodes_of_test.py, name: other,
                      params: {{folder: "{folder}"}}}}, cpu: 5%}}
      managed: {{ros2: {{node: "nodes_of_test:Managed",
                        params: {{folder: "{folder}"}}}}}}
    connectors:
      - {{between: [talker, ear], topic: /heard, message: 20 B, rate: 50 Hz}}
      - {{between: [talker, other], topic: /heard, message: 20 B, rate: 50 Hz}}
tasks:
  work: {{actions: [{{name: work, functions: [speak]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "nodes", "nodes_of_test", NODES, FILE)


def heard(file: Path, name: str) -> int:
    try:
        return int(json.loads((file.parent / name).read_text())["data"])
    except FileNotFoundError:
        return 0


def did(file: Path) -> list[list[str]]:
    """Return what each incarnation of the lifecycle node did."""
    found = sorted(file.parent.glob("managed-*[0-9]"), key=lambda p: p.stat().st_mtime)
    return [json.loads(path.read_text())["did"] for path in found]


def part(running: poise.Running, name: str) -> ComponentStatus:
    parts = {c.name: c for c in components_of(running.status().computers)}
    return parts[name]


def test_nodes_work_on_two_computers_and_move(file: Path) -> None:
    robot = poise.load(file)
    with poise.up(robot) as running:
        wait_long(lambda: min(heard(file, "ear"), heard(file, "other")) > 20)
        wait_long(lambda: "five is wrong" in part(running, "ear").error)
        (topic, *_) = running.status().by_ros2
        with pytest.raises(UsageError, match="by ROS 2 alone: `ros2 topic echo /heard"):
            next(running.echo(topic))
        before = running.status()
        to = {
            n: "right" if at == "left" else "left" for n, at in before.placement.items()
        }

        def move(node: str) -> MigrationReport:
            # while nodes start, a slow computer is so full that none may come
            return running.move(node, to[node], force=True)

        number, cpu = heard(file, "other"), part(running, "talker").cpu
        moved = move("talker")
        # `other` is on the other computer now, or has come to be on the same
        wait_long(lambda: heard(file, "other") > number + 20)
        assert did(file) == [["configure", "activate"]]
        move("managed")
        anew = move("ear")
        wait_long(lambda: heard(file, "ear") > number + 40)
        cold = move("other")
        number = heard(file, "other")
        wait_long(lambda: heard(file, "other") > number + 20)
    assert cpu > 0
    assert (moved.committed, moved.cold, moved.stateless) == (True, False, False)
    assert (anew.committed, anew.cold, anew.stateless) == (True, False, True)
    assert (cold.committed, cold.cold) == (True, True)
    whole = ["configure", "activate", "deactivate", "cleanup"]
    assert did(file) == [whole, whole]


HEARING = """
import json, os
from rclpy.node import Node
from std_msgs.msg import Int32

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.count = 0
        self.counts = self.create_publisher(Int32, "/count", 2000)
        self.create_timer(0.005, self.tick)

    def tick(self):
        self.count += 1
        self.counts.publish(Int32(data=self.count))

class Ear(Node):
    def __init__(self):
        super().__init__("ear")
        self.declare_parameter("folder", "")
        self.path = self.get_parameter("folder").value + "/took"
        self.took = []
        # on a busy machine a node gets no CPU for seconds
        self.create_subscription(Int32, "/count", self.take, 2000)

    def take(self, message):
        self.took.append(message.data)
        if len(self.took) % 100 == 0:
            with open(self.path + ".new", "w") as file:
                json.dump(self.took, file)
            os.replace(self.path + ".new", self.path)

    def snapshot(self):
        return {"took": self.took}

    def restore(self, state):
        self.took = state["took"]
"""
HEARING_FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  hear:
    function: hear
    components:
      talker: {{ros2: {{node: "hearing_of_test:Talker"}}, only: [left]}}
      ear: {{ros2: {{node: "hearing_of_test:Ear", params: {{folder: "{folder}"}}}}}}
tasks:
  work: {{actions: [{{name: work, functions: [hear]}}]}}
"""


def test_a_node_that_moves_takes_each_message_once(tmp_path: Path) -> None:
    file = written(tmp_path, "hearing", "hearing_of_test", HEARING, HEARING_FILE)

    def took() -> list[int]:
        path = tmp_path / "took"
        return list(json.loads(path.read_text())) if path.exists() else []

    def heard_more_than(number: int) -> bool:
        return len(took()) > number

    with poise.up(poise.load(file)) as running:
        for numbers_before in (100, 300, 500, 700):
            wait_long(partial(heard_more_than, numbers_before))
            here = running.status().placement["ear"]
            running.move("ear", "left" if here == "right" else "right", force=True)
        wait_long(partial(heard_more_than, 900))
    numbers = took()
    assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
