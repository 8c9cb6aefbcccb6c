"""Reads the laser range finder, and the wheels' odometry along with it."""

from __future__ import annotations

from collections import deque

import numpy as np

from poise import Component, Published, every
from trot.device import Device
from trot.laser_model import MAX_RANGE, PERIOD
from trot.messages import Pose, Scan
from trot.packets import Odometry, unpack_odometry, unpack_ranges


class LaserScanner(Component):
    """Publishes each scan with the odometry of the same moment."""

    scan: Published[Scan]

    def configure(self) -> None:
        self._laser = Device(self.device("laser"))
        self._wheels = Device(self.device("wheels"))
        self._odometry: deque[Odometry] = deque(maxlen=64)

    @every(PERIOD)
    def read(self) -> None:
        # The wait keeps the timer in step with the laser: no scan lies about.
        packets = self._laser.receive(timeout=0.8 * PERIOD)
        self._odometry += [unpack_odometry(p) for p in self._wheels.receive()]
        if not packets or not self._odometry:
            return
        stamp, ranges = unpack_ranges(packets[-1])
        ranges = np.clip(ranges, 0.0, MAX_RANGE)
        at, *pose = min(self._odometry, key=lambda o: abs(o[0] - stamp))
        odometry = Pose(self.clock.stamp(at), *pose)
        self.scan.publish(Scan(self.clock.stamp(stamp), ranges, odometry))

    def cleanup(self) -> None:
        self._laser.close()
        self._wheels.close()
