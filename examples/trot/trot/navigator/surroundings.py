"""The room around the robot, as a map shows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trot import home
from trot.messages import Map, Pose
from trot.navigator import grid
from trot.navigator.mapper import occupied

MARGIN = 0.03
"""[m] Beyond the robot's radius."""

SIDE = 1.8
"""[m] Half the side of the part of the map that is looked at."""

FAR = 0.5
"""[m] Obstacles further away than this do not matter."""


class Surroundings:
    """How far it is to the next obstacle, anywhere near the robot."""

    def __init__(self, pose: Pose, seen: Map) -> None:
        centre = np.array([pose.x, pose.y])
        low, high = centre - SIDE, centre + SIDE
        self._left = int(grid.column(low[:1])[0])
        self._bottom = int(grid.row(low[1:])[0])
        right, top = int(grid.column(high[:1])[0]), int(grid.row(high[1:])[0])
        window = seen.cells[self._bottom : top + 1, self._left : right + 1]
        self._room = grid.distance(occupied(window), FAR, grid.CELL)
        here = float(self.clearance(*centre.reshape(2, 1, 1))[0])
        # Where it stands too near an obstacle already it may go on, but no nearer.
        self._needed = min(home.ROBOT_RADIUS + MARGIN, here - 1e-3)

    def clearance(self, x: grid.Floats, y: grid.Floats) -> grid.Floats:
        """Return how near [m] each way comes to an obstacle, `FAR` at most, ``(n,)``.

        Parameters
        ----------
        x, y
            Points along the ways [m], within `SIDE` of the robot, ``(n, steps)``.
        """
        rows = np.minimum(grid.row(y) - self._bottom, self._room.shape[0] - 1)
        columns = np.minimum(grid.column(x) - self._left, self._room.shape[1] - 1)
        return np.asarray(self._room[rows, columns].min(axis=1), float)

    def is_wide(self, clearance: grid.Floats) -> NDArray[np.bool_]:
        """Return which ways are wide enough for the robot, by their clearance [m]."""
        return np.asarray(clearance >= self._needed)
