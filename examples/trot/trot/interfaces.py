"""What T-Rot's components call each other for."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trot.messages import Map, Pose, Programme


class Poses(Protocol):
    """Knows where the robot is."""

    def latest_pose(self) -> Pose:
        """Return the newest pose."""
        ...


class Maps(Protocol):
    """Knows what is around the robot."""

    def latest_map(self) -> Map:
        """Return the map with the newest scan in it."""
        ...


class Kinematics(Protocol):
    """Knows how the arm bends."""

    def solve(
        self, target: NDArray[np.float32], start: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return joint angles [rad] that bring the hand to `target` x, y, z [m]."""
        ...


class Collisions(Protocol):
    """Knows what the arm must not touch."""

    def clearance(self, postures: NDArray[np.float32]) -> float:
        """Return how near [m] the arm comes to anything in `postures` ``(n, 6)``."""
        ...


class Guide(Protocol):
    """Knows what is on television."""

    def search(self, genre: int) -> list[Programme]:
        """Return the programmes of a genre that begin next."""
        ...


class Tastes(Protocol):
    """Knows what the viewer likes."""

    def weights(self) -> NDArray[np.float32]:
        """Return how much the viewer likes each genre, ``(GENRES,)``."""
        ...


class Ratings(Protocol):
    """Predicts what the viewer would think of a programme."""

    def predict(self, numbers: list[int]) -> list[float]:
        """Return the predicted rating of each programme, about 0 to 1."""
        ...
