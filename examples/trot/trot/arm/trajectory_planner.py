"""Plans how the hand gets to where a gesture wants it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Published, Required, every, subscribed
from trot.arm import geometry
from trot.effort import Block, Effort
from trot.interfaces import Collisions, Kinematics
from trot.messages import Gesture, Trajectory

STEPS = 50
"""Points of a trajectory, 20 ms apart."""

NEAR = 0.02
"""[m] A trajectory that comes nearer to anything is not used."""


class TrajectoryPlanner(Component):
    """Five times a second: solve, smooth, check, publish."""

    kinematics: Required[Kinematics]
    collisions: Required[Collisions]
    trajectory: Published[Trajectory]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._target = np.array([0.4, 0.0, 0.1], np.float32)
        self._angles = np.array([0, 0.6, 0, -0.6, 0, 0], np.float32)

    @subscribed(keep=1)
    def gesture(self, message: Gesture) -> None:
        self._target = np.array([message.x, message.y, message.z], np.float32)

    @every(0.2)
    def plan(self) -> None:
        since = self._effort.start()
        self._effort.spend(_smooth, since)
        try:
            end = self.kinematics.solve(self._target, self._angles)
            angles = between(self._angles, end)
            if self.collisions.clearance(angles[::5]) < NEAR:
                return
        except CallError as error:
            self.log.info("no trajectory this time: %s", error)
            return
        self._angles = angles[STEPS // 5]
        self.trajectory.publish(Trajectory(self.clock.now(), angles))


def between(start: geometry.Angles, end: geometry.Angles) -> NDArray[np.float32]:
    """Return a trajectory of least jerk from `start` to `end`, ``(STEPS, JOINTS)``."""
    time = np.linspace(0, 1, STEPS)[:, None]
    share = 10 * time**3 - 15 * time**4 + 6 * time**5
    return (start + share * (end - start)).astype(np.float32)


def _smooth(block: Block) -> float:
    """Return the least jerk of 340 stored trajectories of one joint."""
    jerk = np.diff(block[:16_320].reshape(-1, 48), n=3, axis=1)
    return float(np.square(jerk).sum(axis=1).min())
