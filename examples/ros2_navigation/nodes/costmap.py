"""What a metre costs anywhere: dear near obstacles, 100 where the robot cannot be."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from running import run

from trot import home
from trot.navigator import grid

COMFORT = 0.55
"""[m] Nearer to an obstacle than this a way is dearer."""


class Costmap(Node):
    """Inflates the obstacles of each map."""

    def __init__(self) -> None:
        super().__init__("costmap")
        self.costs = self.create_publisher(OccupancyGrid, "costmap", 1)
        self.create_subscription(OccupancyGrid, "map", self.inflate, 1)

    def inflate(self, message: OccupancyGrid) -> None:
        cells = np.array(message.data, np.int8).reshape(grid.SIZE, grid.SIZE)
        room = grid.distance(cells >= 50, COMFORT, grid.CELL)
        cost = 1 + 40 * (1 - room / COMFORT) ** 2
        cost[room < home.ROBOT_RADIUS + 0.05] = 100
        message.data = cost.astype(np.int8).ravel().tolist()
        self.costs.publish(message)


if __name__ == "__main__":
    run(Costmap)
