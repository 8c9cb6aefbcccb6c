"""Speeds along the path, 20 times a second; a lifecycle node."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from running import run

PERIOD = 0.05
"""[s] It is late when it needs longer."""
AHEAD = 0.5
"""[m] The point of the path to make for."""
ARRIVED = 0.15
OLD = 0.5
"""[s] With an older pose the robot stands still."""


class Controller(LifecycleNode):
    """Tries commands out, and takes the one that leads nearest to the path."""

    def __init__(self) -> None:
        super().__init__("controller")
        self.path = np.zeros((0, 2))
        self.at: PoseStamped | None = None
        self.timer: Any = None
        count = self.declare_parameter("turns", 1200).value
        tried = np.meshgrid(np.linspace(0, 0.5, 10), np.linspace(-1.5, 1.5, count))
        self.commands = [each.reshape(-1, 1) for each in tried]

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.speeds = self.create_publisher(TwistStamped, "cmd_vel", 1)
        self.create_subscription(Path, "path", self.take_path, 1)
        self.create_subscription(PoseStamped, "pose", self.take_pose, 1)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.timer = self.create_timer(PERIOD, self.control)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.destroy_timer(self.timer)
        return super().on_deactivate(state)

    def take_path(self, message: Path) -> None:
        points = [(p.pose.position.x, p.pose.position.y) for p in message.poses]
        self.path = np.array(points).reshape(-1, 2)

    def take_pose(self, message: PoseStamped) -> None:
        self.at = message

    def control(self) -> None:
        message = TwistStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        if self.at is not None:
            message.header.stamp = self.at.header.stamp
            speed, turn = self.best(self.at)
            message.twist.linear.x, message.twist.angular.z = speed, turn
        self.speeds.publish(message)

    def best(self, at: PoseStamped) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s]."""
        stamp, place = at.header.stamp, at.pose.position
        age = self.get_clock().now().nanoseconds / 1e9
        age -= stamp.sec + stamp.nanosec / 1e9
        if age > OLD or len(self.path) == 0:
            return 0.0, 0.0
        away = np.hypot(self.path[:, 0] - place.x, self.path[:, 1] - place.y)
        if away[-1] < ARRIVED:
            return 0.0, 0.0
        after = np.flatnonzero(away[away.argmin() :] > AHEAD)
        index = away.argmin() + after[0] if len(after) else len(away) - 1
        return self.nearest(self.path[index], (place.x, place.y, place.z))

    def nearest(
        self, to: np.ndarray, at: tuple[float, float, float]
    ) -> tuple[float, float]:
        """Return the command that leads nearest to a point, of all that are tried."""
        speed, turn = self.commands
        heading = at[2] + turn * np.linspace(0, 1, 25)
        x = at[0] + np.cumsum(speed * np.cos(heading), axis=1) / 25
        y = at[1] + np.cumsum(speed * np.sin(heading), axis=1) / 25
        away = np.hypot(x - to[0], y - to[1]).min(axis=1)
        off = np.arctan2(to[1] - at[1], to[0] - at[0]) - heading[:, 12]
        cost = away + 0.2 * np.abs(np.remainder(off + np.pi, 2 * np.pi) - np.pi)
        best = int(cost.argmin())
        return float(speed[best, 0]), float(turn[best, 0])


if __name__ == "__main__":
    run(Controller)
