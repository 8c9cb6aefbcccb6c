"""The way to the goal: Dijkstra on the costs, once a second."""

from __future__ import annotations

import heapq
from itertools import product

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.node import Node
from running import pose, run

from trot.navigator import grid

COARSE = 2
"""Cells to a side of one of the planner's: 10 cm."""
SIZE = grid.SIZE // COARSE
STEPS = [(r, c) for r, c in product((-1, 0, 1), repeat=2) if r or c]

Cell = tuple[int, int]


def way(cost: np.ndarray, start: Cell, goal: Cell) -> list[Cell]:  # type: ignore[type-arg]
    """Return the cheapest way; empty when there is none."""
    best, waiting, towards = {goal: 0.0}, [(0.0, goal)], {goal: goal}
    while waiting:
        so_far, cell = heapq.heappop(waiting)
        if cell == start:
            found = [cell]
            while cell != goal:
                cell = towards[cell]
                found.append(cell)
            return found
        for down, right in STEPS:
            after = cell[0] + down, cell[1] + right
            if not (0 <= after[0] < SIZE and 0 <= after[1] < SIZE):
                continue
            total = so_far + float(np.hypot(down, right)) * float(cost[after])
            if total < best.get(after, np.inf):
                best[after], towards[after] = total, cell
                heapq.heappush(waiting, (total, after))
    return []


class Planner(Node):
    """Publishes a path from where the robot is."""

    def __init__(self) -> None:
        super().__init__("planner")
        self.cost = np.ones((SIZE, SIZE))
        self.at: PoseStamped | None = None
        self.goal: PoseStamped | None = None
        self.paths = self.create_publisher(Path, "path", 1)
        self.create_subscription(OccupancyGrid, "costmap", self.take_cost, 1)
        self.create_subscription(PoseStamped, "pose", self.take_pose, 1)
        self.create_subscription(PoseStamped, "goal", self.take_goal, 1)
        self.create_timer(1.0, self.plan)

    def take_cost(self, message: OccupancyGrid) -> None:
        cells = np.array(message.data, float).reshape(SIZE, COARSE, SIZE, COARSE)
        worst = cells.max(axis=(1, 3))
        self.cost = np.where(worst >= 100, 1000.0, worst)

    def take_pose(self, message: PoseStamped) -> None:
        self.at = message

    def take_goal(self, message: PoseStamped) -> None:
        self.goal = message

    def plan(self) -> None:
        if self.at is None or self.goal is None:
            return
        path = Path()
        path.header = self.at.header
        for row, column in way(self.cost, cell(self.at), cell(self.goal)):
            x = grid.ORIGIN[0] + (column + 0.5) * COARSE * grid.CELL
            y = grid.ORIGIN[1] + (row + 0.5) * COARSE * grid.CELL
            path.poses.append(pose(path.header.stamp, x, y, 0.0))
        self.paths.publish(path)


def cell(message: PoseStamped) -> Cell:
    """Return row and column of a pose."""
    at = message.pose.position
    row, column = grid.row(np.array(at.y)), grid.column(np.array(at.x))
    return int(row) // COARSE, int(column) // COARSE


if __name__ == "__main__":
    run(Planner)
