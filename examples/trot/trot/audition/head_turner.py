"""Turns the head to the person who spoke last, while the robot drives."""

from __future__ import annotations

import math

from poise import CallError, Component, Published, Required, every, subscribed
from trot.device import Device
from trot.interfaces import Poses
from trot.messages import Attention, Seen, Source
from trot.packets import pack_angle

HEARD = 1.0
"""[s] Who was heard later than this is turned to; else whose face is seen."""


class HeadTurner(Component):
    """Looks ten times a second where the person is, from where the robot is now.

    That is where somebody speaks, or, between sentences, where a face is seen.
    """

    poses: Required[Poses]
    attention: Published[Attention]

    def configure(self) -> None:
        self._neck = Device(self.device("pan_tilt"))
        self._place: tuple[float, float] | None = None
        self._heard = -math.inf

    @subscribed(keep=1)
    def source(self, message: Source) -> None:
        self._place, self._heard = (message.x, message.y), self.clock.now()

    @subscribed(keep=1)
    def seen(self, message: Seen) -> None:
        if self.clock.now() - self._heard < HEARD:
            return
        try:
            pose = self.poses.latest_pose()
        except CallError as error:
            self.log.debug("somebody is seen from nowhere: %s", error)
            return
        angle = pose.heading + message.bearing
        self._place = (
            pose.x + message.distance * math.cos(angle),
            pose.y + message.distance * math.sin(angle),
        )

    @every(0.1, deadline=0.1)
    def turn(self) -> None:
        if self._place is None:
            return
        try:
            pose = self.poses.latest_pose()
        except CallError as error:
            self.log.debug("the head stays where it is: %s", error)
            return
        away = math.atan2(self._place[1] - pose.y, self._place[0] - pose.x)
        bearing = math.remainder(away - pose.heading, 2 * math.pi)
        self._neck.send(pack_angle(bearing))
        self.attention.publish(Attention(self.clock.now(), bearing))

    def cleanup(self) -> None:
        self._neck.close()
