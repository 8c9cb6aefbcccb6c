"""Counts what goes over the topics that matter afterwards."""

from __future__ import annotations

from collections import Counter
from functools import partial

from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.node import Node
from running import run
from std_msgs.msg import String


class Recorder(Node):
    """Says every ten seconds how many messages came."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self.counts: Counter[str] = Counter()
        topics = {"pose": PoseStamped, "detections": PointStamped, "words": String}
        for name, type_ in topics.items():
            self.create_subscription(type_, name, partial(self.count, name), 10)
        self.create_timer(10.0, self.say)

    def count(self, name: str, _message: object) -> None:
        self.counts[name] += 1

    def say(self) -> None:
        self.get_logger().info(f"recorded {dict(self.counts)}")


if __name__ == "__main__":
    run(Recorder)
