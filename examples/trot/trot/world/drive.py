"""How the robot drives, seen from outside: its path, and how far off it was."""

from __future__ import annotations

from typing import Any

import numpy as np

from trot import home
from trot.navigator import grid
from trot.navigator.path_planner import way
from trot.world.simulation import Simulation

EVERY = 0.2
"""[s] from point to point of the path that is kept."""


class Drive:
    """The drive so far, compared with the best way through the home as it is."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._points: list[tuple[float, float]] = []
        self._best = best_way(simulation.pose[:2], home.GOAL)

    def look(self) -> None:
        """Keep where the robot is; to be called every step."""
        if self._simulation.now >= EVERY * len(self._points):
            self._points.append(self._simulation.pose[:2])

    def result(self) -> dict[str, Any]:
        """Return the path x, y [m], and its mean and largest distance from the best."""
        path = np.array([*self._points, self._simulation.pose[:2]])
        away = np.linalg.norm(path[:, None] - self._best, axis=2).min(axis=1)
        return {
            "path": path.round(3).tolist(),
            "walls": home.WALLS,
            "goal": home.GOAL,
            "path_error": round(float(away.mean()), 3),
            "path_error_most": round(float(away.max()), 3),
            "collisions": self._simulation.collisions,
            "path_length": round(self._simulation.path_length, 3),
            "distance_to_goal": round(self._simulation.distance_to_goal, 3),
        }


def best_way(
    start: tuple[float, float], goal: tuple[float, float]
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Return the way [m] that a planner finds who knows all furniture, ``(n, 2)``."""
    cells = np.where(grid.walls(), np.int8(100), np.int8(0))
    for left, bottom, right, top in home.FURNITURE:
        columns = grid.column(np.array([left, right]))
        rows = grid.row(np.array([bottom, top]))
        cells[rows[0] : rows[1] + 1, columns[0] : columns[1] + 1] = 100
    return way(cells, start, goal)
