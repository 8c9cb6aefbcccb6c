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


class Knowledge(Protocol):
    """Knows the household."""

    def ask(self, subject: str, verb: str) -> str:
        """Return what a subject has, does or is; empty when nobody knows."""
        ...


class Guide(Protocol):
    """Knows what is on television."""

    def on_air(self) -> list[Programme]:
        """Return the programmes that are on the air now."""
        ...


class Tastes(Protocol):
    """Knows what the viewer likes."""

    def weights(self) -> NDArray[np.float64]:
        """Return the share of each genre in what was watched, ``(GENRES,)``."""
        ...


class Ratings(Protocol):
    """Predicts what the viewer would think of a programme."""

    def predict(self, numbers: list[int]) -> list[float]:
        """Return how much the viewer likes each programme; higher is better."""
        ...
