"""The map: the walls it knows, and what the laser sees besides."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from running import run
from sensor_msgs.msg import LaserScan

from trot.laser_model import ANGLES, MAX_RANGE
from trot.navigator import grid


class Mapper(Node):
    """Fills the cells in which beams end, and publishes the map twice a second."""

    def __init__(self) -> None:
        super().__init__("mapper")
        self.cells = np.where(grid.walls(), 100, 0).astype(np.int8)
        self.ranges = np.zeros(0)
        self.maps = self.create_publisher(OccupancyGrid, "map", 1)
        self.create_subscription(LaserScan, "scan", self.scan, 1)
        self.create_subscription(PoseStamped, "pose", self.located, 1)
        self.create_timer(0.5, self.publish)

    def scan(self, message: LaserScan) -> None:
        self.ranges = np.asarray(message.ranges)

    def located(self, message: PoseStamped) -> None:
        self.stamp, at = message.header.stamp, message.pose.position
        hits = self.ranges < MAX_RANGE - 0.05
        directions = at.z + ANGLES[: len(hits)][hits]
        x = at.x + self.ranges[hits] * np.cos(directions)
        y = at.y + self.ranges[hits] * np.sin(directions)
        seen = np.maximum(self.cells.astype(np.int16) - 1, 0)
        seen[grid.row(y), grid.column(x)] += 30
        self.cells = np.where(grid.walls(), 100, np.minimum(seen, 100)).astype(np.int8)

    def publish(self) -> None:
        message = OccupancyGrid()
        message.header.stamp = getattr(self, "stamp", message.header.stamp)
        message.info.width = message.info.height = grid.SIZE
        message.info.resolution = grid.CELL
        message.data = self.cells.ravel().tolist()
        self.maps.publish(message)


if __name__ == "__main__":
    run(Mapper)
