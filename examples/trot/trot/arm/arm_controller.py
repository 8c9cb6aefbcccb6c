"""Follows a trajectory, joint by joint."""

from __future__ import annotations

import numpy as np

from poise import Component, Published, every, subscribed
from trot.arm import geometry
from trot.effort import Block, Effort
from trot.messages import Joints, Trajectory

STRIDE = 2.5
"""Points of the trajectory (20 ms) in a cycle of 50 ms."""

STIFFNESS = 0.6
"""The share of the way to the wanted angle that a joint goes in a cycle."""


class ArmController(Component):
    """Moves simulated joints along the newest trajectory, 20 times a second."""

    joints: Published[Joints]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._angles = np.zeros(geometry.JOINTS, np.float32)
        self._wanted = np.zeros((1, geometry.JOINTS), np.float32)
        self._at = 0.0

    @subscribed(keep=1)
    def trajectory(self, message: Trajectory) -> None:
        self._wanted = message.angles
        self._at = 0.0

    @every(0.05)
    def control(self) -> None:
        since = self._effort.start()
        self._at = min(self._at + STRIDE, len(self._wanted) - 1)
        self._angles = self._angles + STIFFNESS * (
            self._wanted[int(self._at)] - self._angles
        )
        self._effort.spend(_torques, since)
        self.joints.publish(Joints(self.clock.now(), self._angles))


def _torques(block: Block) -> float:
    """Return the largest of many torques that a motion would take."""
    angles = block[:6000].reshape(-1, geometry.JOINTS)
    lever = np.abs(geometry.points(angles)[..., 0])
    return float(lever.sum(axis=-1).max())
