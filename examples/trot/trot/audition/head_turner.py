"""Turns the head to the person who spoke last, while the robot drives."""

from __future__ import annotations

import math

from poise import CallError, Component, Published, Required, every, subscribed
from trot.device import Device
from trot.interfaces import Poses
from trot.messages import Attention, Source
from trot.packets import pack_angle


class HeadTurner(Component):
    """Looks ten times a second where the person is, from where the robot is now."""

    poses: Required[Poses]
    attention: Published[Attention]

    def configure(self) -> None:
        self._neck = Device(self.device("pan_tilt"))
        self._source: Source | None = None

    @subscribed(keep=1)
    def source(self, message: Source) -> None:
        self._source = message

    @every(0.1, deadline=0.1)
    def turn(self) -> None:
        if self._source is None:
            return
        try:
            pose = self.poses.latest_pose()
        except CallError as error:
            self.log.info("the head stays where it is: %s", error)
            return
        away = math.atan2(self._source.y - pose.y, self._source.x - pose.x)
        bearing = math.remainder(away - pose.heading, 2 * math.pi)
        self._neck.send(pack_angle(bearing))
        self.attention.publish(Attention(self.clock.now(), bearing))

    def cleanup(self) -> None:
        self._neck.close()
