"""Moves the arm along a trajectory, and closes or opens the hand at its end."""

from __future__ import annotations

import numpy as np

from poise import Component, Published, every, subscribed
from trot.arm import arm_model
from trot.device import Device
from trot.messages import Joints, Trajectory
from trot.packets import pack_arm, unpack_arm

SETTLED = 0.03
"""[rad] A joint this near its end has arrived."""


class ArmController(Component):
    """Commands the next posture 50 times a second, and publishes the last one read."""

    joints: Published[Joints]

    def configure(self) -> None:
        self._motors = Device(self.device("arm"))
        self._way = np.array([arm_model.REST], np.float32)
        self._at, self._number, self._done = 0, 0, 0
        self._closes = self._closed = False
        self._angles = self._way[0]
        self._ticks = 0

    @subscribed(keep=1)
    def trajectory(self, message: Trajectory) -> None:
        self._way, self._at = message.angles, 0
        self._number, self._closes = message.number, message.closes

    @every(0.02, deadline=0.02)
    def control(self) -> None:
        for packet in self._motors.receive()[-1:]:
            self._angles = unpack_arm(packet)[0].astype(np.float32)
        self._at = min(self._at + 1, len(self._way) - 1)
        if self._at == len(self._way) - 1 and self._is_settled():
            self._closed, self._done = self._closes, self._number
        self._motors.send(pack_arm(self._way[self._at], closed=self._closed))
        self._ticks += 1
        if self._ticks % 3 == 0:
            stamp = self.clock.now()
            self.joints.publish(Joints(stamp, self._angles, self._done))

    def cleanup(self) -> None:
        self._motors.close()

    def _is_settled(self) -> bool:
        return float(np.abs(self._angles - self._way[-1]).max()) < SETTLED
