"""Moves the arm along the planned motion, and stops it when a person is near."""

from __future__ import annotations

import numpy as np

from poise import Component, every, subscribed
from sorter import arm_model
from sorter.device import Device
from sorter.messages import STEP, Guard, Motion

TRUSTED = 0.4
"""[s] When the guard's last word is older than this, somebody may be near."""


class ArmController(Component):
    """Commands the next posture 50 times a second."""

    def configure(self) -> None:
        self._arm = Device(self.device("arm"))
        self._measured = arm_model.REST
        self._motion: Motion | None = None
        self._guard: Guard | None = None

    @subscribed(keep=1)
    def motion(self, message: Motion) -> None:
        self._motion = message

    @subscribed(keep=1)
    def guard(self, message: Guard) -> None:
        self._guard = message

    @every(0.02, deadline=0.02)
    def control(self) -> None:
        if (packet := self._arm.newest()) is not None:
            self._measured = np.array(packet[0])
        wanted = self._wanted() if self._may_move() else None
        angles = self._measured if wanted is None else wanted
        self._arm.send([float(angle) for angle in angles])

    def _may_move(self) -> bool:
        if self._guard is None or not self._guard.clear:
            return False
        age = self.clock.since(self._guard.seen)
        return age is not None and age.most < TRUSTED

    def _wanted(self) -> np.ndarray | None:
        """Return the motion's posture for now; None: there is no motion."""
        if (
            self._motion is None
            or (at := self.clock.since(self._motion.begins)) is None
        ):
            return None
        steps = np.arange(len(self._motion.angles)) * STEP
        joints = self._motion.angles.T
        return np.array([np.interp(at.value, steps, joint) for joint in joints])

    def cleanup(self) -> None:
        self._arm.close()
