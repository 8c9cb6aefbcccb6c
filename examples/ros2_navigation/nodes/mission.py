"""Where to go: to the kitchen and back, again and again."""

from __future__ import annotations

import math

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from running import pose, run

from trot import home

GOALS = (home.GOAL, home.START[:2])


class Mission(Node):
    """Publishes the goal once a second, and the next one when the robot is there."""

    def __init__(self) -> None:
        super().__init__("mission")
        self.reached = 0
        self.goals = self.create_publisher(PoseStamped, "goal", 1)
        self.create_subscription(PoseStamped, "pose", self.located, 1)
        self.create_timer(1.0, self.publish)

    def located(self, message: PoseStamped) -> None:
        at = message.pose.position
        if math.dist((at.x, at.y), GOALS[self.reached % 2]) < home.GOAL_RADIUS:
            self.reached += 1
            self.get_logger().info(f"reached {self.reached} goals")

    def publish(self) -> None:
        x, y = GOALS[self.reached % 2]
        self.goals.publish(pose(self.get_clock().now().to_msg(), x, y, 0.0))


if __name__ == "__main__":
    run(Mission)
