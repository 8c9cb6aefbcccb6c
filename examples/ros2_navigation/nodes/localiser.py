"""Where the robot is: poses around the odometry's, tried on the walls it knows."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from running import pose, run
from sensor_msgs.msg import LaserScan

from trot import home
from trot.laser_model import ANGLES, MAX_RANGE
from trot.navigator import grid


class Localiser(Node):
    """A particle filter; `particles` says how much it tries."""

    def __init__(self) -> None:
        super().__init__("localiser")
        count = self.declare_parameter("particles", 600).value
        self.random = np.random.default_rng(0)
        spread = self.random.normal(0, 1, (count, 3)) * (0.1, 0.1, 0.05)
        self.particles = np.asarray(home.START) + spread
        field = grid.distance(grid.walls(), 1.0, grid.CELL).astype(float)
        self.likelihood = np.log(0.1 + np.exp(-((field / 0.1) ** 2) / 2))
        self.odometry: tuple[float, float, float] | None = None
        self.poses = self.create_publisher(PoseStamped, "pose", 10)
        self.create_subscription(Odometry, "odom", self.move, 10)
        self.create_subscription(LaserScan, "scan", self.scan, 1)

    def move(self, message: Odometry) -> None:
        """Move the particles as the wheels counted, with noise."""
        at = message.pose.pose.position
        last, self.odometry = self.odometry, (at.x, at.y, at.z)
        if last is None:
            return
        length = math.hypot(at.x - last[0], at.y - last[1])
        along = math.atan2(at.y - last[1], at.x - last[0]) - last[2]
        turn = at.z - last[2]
        heading = self.particles[:, 2] + turn / 2
        self.particles[:, 0] += length * math.cos(along) * np.cos(heading)
        self.particles[:, 1] += length * math.cos(along) * np.sin(heading)
        self.particles[:, 2] += turn
        scale = (0.005 + 0.1 * length, 0.005 + 0.1 * length, 0.003 + 0.1 * abs(turn))
        self.particles += self.random.normal(0, 1, self.particles.shape) * scale

    def scan(self, message: LaserScan) -> None:
        """Weigh the particles by the scan, publish their mean, and draw anew."""
        ranges = np.asarray(message.ranges)[::3]
        hits = ranges < MAX_RANGE - 0.05
        ranges, angles = ranges[hits], ANGLES[::3][hits]
        directions = self.particles[:, 2:] + angles
        x = self.particles[:, :1] + ranges * np.cos(directions)
        y = self.particles[:, 1:2] + ranges * np.sin(directions)
        score = 0.15 * self.likelihood[grid.row(y), grid.column(x)].sum(axis=1)
        weights = np.exp(score - score.max())
        weights /= weights.sum()
        heading = self.particles[:, 2]
        turned = math.atan2(weights @ np.sin(heading), weights @ np.cos(heading))
        x_mean, y_mean, _ = weights @ self.particles
        self.poses.publish(pose(message.header.stamp, x_mean, y_mean, turned))
        count = len(weights)
        ticks = (np.arange(count) + self.random.random()) / count
        chosen = np.searchsorted(np.cumsum(weights), ticks)
        self.particles = self.particles[np.minimum(chosen, count - 1)]


if __name__ == "__main__":
    run(Localiser)
