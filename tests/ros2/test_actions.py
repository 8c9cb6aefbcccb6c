"""Actions of ROS 2 as methods of ports, both ways, with a node of rclpy."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

import poise
from poise.errors import RunError
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(2 * LONG)]

CODE = """
import json, os, sys, threading, time
import rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
import poise
from poise import Component, Provided, Required

FOLDER = os.path.dirname(os.path.abspath(__file__))

class Counting:
    def fibonacci(self, order: int) -> list[int]: ...

class Asks:
    def ask(self, order: int, limit: float) -> list[int]: ...

def numbers(order):
    found = [0, 1]
    while len(found) < order:
        found.append(found[-1] + found[-2])
    return found[:order]

class Counter(Component):
    near: Provided[Counting]

    def fibonacci(self, order: int) -> list[int]:
        if order < 0:
            raise ValueError("it has an end")
        if order == 77:
            threading.Event().wait(2.0)
        return numbers(order)

class Asker(Component):
    far: Required[Counting]
    asks: Provided[Asks]

    def ask(self, order: int, limit: float) -> list[int]:
        with poise.within(limit):
            return self.far.fibonacci(order)

class Peer(Node):
    def __init__(self):
        super().__init__("peer")
        from test_msgs.action import Fibonacci
        self.kind, group = Fibonacci, ReentrantCallbackGroup()
        self.near = ActionClient(self, Fibonacci, "/near", callback_group=group)
        self.far = ActionServer(
            self, Fibonacci, "/far", self.run, callback_group=group,
            goal_callback=self.accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def accept(self, goal):
        if goal.order == 78:
            threading.Event().wait(0.8)
        return GoalResponse.REJECT if goal.order == 66 else GoalResponse.ACCEPT

    def run(self, goal):
        order = goal.request.order
        if order < 0:
            goal.abort()
            return self.kind.Result()
        while order in (77, 78) and not goal.is_cancel_requested:
            threading.Event().wait(0.05)
        if order in (77, 78):
            goal.canceled()
            write(f"cancelled-{order}", True)
            return self.kind.Result()
        goal.succeed()
        return self.kind.Result(sequence=numbers(order))

    def ask(self, order):
        answer = self.near.send_goal(self.kind.Goal(order=order))
        return [answer.status, list(answer.result.sequence)]

    def drop(self, order):
        came = threading.Event()
        sent = self.near.send_goal_async(self.kind.Goal(order=order))
        sent.add_done_callback(lambda _: came.set())
        came.wait()
        goal = sent.result()
        refused = not goal.cancel_goal().goals_canceling
        answer = goal.get_result()
        return [answer.status, refused]

    def ask_often(self):
        sent, ended = 0, []
        def take(sent):
            sent.result().get_result_async().add_done_callback(ended.append)
        while not os.path.exists(os.path.join(FOLDER, "moved")):
            goal = self.kind.Goal(order=4)
            self.near.send_goal_async(goal).add_done_callback(take)
            sent += 1
            threading.Event().wait(0.03)
        until = time.monotonic() + 20
        while len(ended) < sent and time.monotonic() < until:
            threading.Event().wait(0.1)
        good = [e for e in ended if list(e.result().result.sequence) == [0, 1, 1, 2]]
        return [sent, len(good)]

def write(name, value):
    path = os.path.join(FOLDER, name)
    with open(path + ".new", "w") as file:
        json.dump(value, file)
    os.replace(path + ".new", path)

def main():
    rclpy.init()
    peer, executor = Peer(), MultiThreadedExecutor(4)
    executor.add_node(peer)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    peer.near.wait_for_server()
    write("ended", [peer.ask(5), peer.ask(-1), peer.drop(77), peer.ask(6),
                    peer.ask(60)])
    write("often", peer.ask_often())
    spinning.join()

if __name__ == "__main__":
    main()
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  count:
    function: count
    components:
      counter: {{implementation: "counting_of_test:Counter"}}
      asker: {{implementation: "counting_of_test:Asker"}}
      peer: {{ros2: {{executable: ./counting_of_test.py}}, only: [right]}}
tasks:
  work: {{actions: [{{name: work, functions: [count]}}]}}
ros2:
  bridges:
    - {{ros2: /near, port: counter.near, type: test_msgs/action/Fibonacci,
       limit: 1 min}}
    - {{ros2: /far, port: asker.far, type: test_msgs/action/Fibonacci, limit: 20 s}}
"""
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def test_goals_are_calls_and_calls_are_goals(tmp_path: Path) -> None:
    if importlib.util.find_spec("test_msgs") is None:
        pytest.skip("no action of ROS 2 is installed: pip install ros-test-msgs")
    file = written(tmp_path, "counting", "counting_of_test", CODE, FILE)

    with poise.up(poise.load(file)) as running:

        def ask(order: int, limit: float = 30.0) -> object:
            asker = running.component("asker")
            return asker.call("asks", "ask", order, limit, limit=40.0)

        assert ask(5) == [0, 1, 1, 2, 3]
        with pytest.raises(RunError, match="'/far' rejected the goal"):
            ask(66)
        with pytest.raises(RunError, match="the goal of '/far' ended aborted"):
            ask(-1)
        with pytest.raises(RunError, match="Timeout"):
            ask(77, 1.0)
        wait_long((tmp_path / "cancelled-77").exists)
        with pytest.raises(RunError, match="Timeout"):
            ask(78, 0.3)  # it is accepted later
        wait_long((tmp_path / "cancelled-78").exists)
        assert ask(3) == [0, 1, 1]
        wait_long((tmp_path / "ended").exists)
        for bridge in ("counter-near-ros2", "asker-far-ros2"):
            here = running.status().placement[bridge]
            there = "left" if here == "right" else "right"
            running.move(bridge, there, force=True)
        (tmp_path / "moved").touch()
        assert ask(4) == [0, 1, 1, 2]
        wait_long((tmp_path / "often").exists)
    sent, good = json.loads((tmp_path / "often").read_text())
    # ROS 2 may connect a client to the bridge's new place later than it says
    assert 0.9 * sent <= good <= sent
    assert json.loads((tmp_path / "ended").read_text()) == [
        [SUCCEEDED, [0, 1, 1, 2, 3]],
        [ABORTED, []],
        [CANCELED, False],
        [SUCCEEDED, [0, 1, 1, 2, 3, 5]],
        [ABORTED, []],  # what is no int32 is no result
    ]
