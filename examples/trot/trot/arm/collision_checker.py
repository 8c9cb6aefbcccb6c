"""Checks that the arm touches nothing: distances to a cloud of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Provided, subscribed
from trot.arm import geometry
from trot.effort import Block, Effort
from trot.interfaces import Collisions
from trot.messages import Joints


class CollisionChecker(Component):
    """Compares postures with a table top in front, and with clouds of points."""

    collisions: Provided[Collisions]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        x, y = np.meshgrid(np.linspace(0.2, 0.8, 12), np.linspace(-0.4, 0.4, 12))
        self._table = np.stack([x, y, np.full_like(x, -0.35)], axis=-1).reshape(-1, 3)
        self._hand = geometry.hand(np.zeros(geometry.JOINTS, np.float32))

    def clearance(self, postures: NDArray[np.float32]) -> float:
        since = self._effort.start()
        parts = geometry.points(postures).reshape(-1, 1, 3)
        nearest = float(np.linalg.norm(parts - self._table, axis=-1).min())
        self._effort.spend(self._cloud, since)
        return nearest

    @subscribed(keep=1)
    def joints(self, message: Joints) -> None:
        self._hand = geometry.hand(message.angles)

    def _cloud(self, block: Block) -> float:
        """Return how near the hand is to a part of the cloud [m]."""
        cloud = block[:16_383].reshape(-1, 3)
        return float(np.sqrt(np.square(cloud - self._hand).sum(axis=1)).min())
