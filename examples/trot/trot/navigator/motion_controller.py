"""Drives: the cycle that checks pose and map every 200 ms (paper, section V)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Required, Stamp, every, subscribed
from trot.device import Device
from trot.interfaces import Maps, Poses
from trot.messages import Map, Path, Pose
from trot.navigator.dynamic_window import Trial, lattice
from trot.navigator.surroundings import Surroundings
from trot.packets import pack_command

BLIND = 0.2
"""[s] With a pose or a map older than this the robot stands still."""

LOOK_AHEAD = 0.7
"""[m] The point of the path to make for."""

NEAR_GOAL = 0.1
"""[m] Here the robot stops."""


class MotionController(Component):
    """Follows the path by what pose and map say, and stands still without them."""

    poses: Required[Poses]
    maps: Required[Maps]

    def configure(self) -> None:
        self._wheels = Device(self.device("wheels"))
        self._commands = lattice(*self.parameters.get("commands", (15, 41)))
        self._path = Path(self.clock.stamp(), np.zeros((0, 2), np.float32))

    @subscribed(keep=1)
    def path(self, message: Path) -> None:
        self._path = message

    @every(0.2, deadline=0.2)
    def cycle(self) -> None:
        try:
            pose, seen = self.poses.latest_pose(), self.maps.latest_map()
        except CallError as error:
            self.log.debug("no command this time: %s", error)
            return
        speed, turn = self._best(pose, seen)
        ages = self._age("pose", pose.stamp), self._age("map", seen.stamp)
        if max(ages) > BLIND:
            speed = turn = 0.0
        self._wheels.send(pack_command(speed, turn))

    def deactivate(self) -> None:
        self._wheels.send(pack_command(0.0, 0.0))

    def cleanup(self) -> None:
        self._wheels.close()

    def _age(self, what: str, stamp: Stamp) -> float:
        """Return how old something is at most [s], on whatever computer it was made."""
        since = self.clock.since(stamp)
        if since is None:
            return math.inf  # nobody knows how far that computer's clock is ahead
        # Before the first path nothing is driven by, and no age matters.
        if len(self._path.points) > 0:
            self.measure(f"{what}_age", since.value)
        return since.most

    def _best(self, pose: Pose, seen: Map) -> tuple[float, float]:
        """Return the best of the commands that can be given."""
        around = Surroundings(pose, seen)
        target = make_for(self._path.points, pose, around)
        if target is None:
            return 0.0, 0.0
        speed, turn = Trial(pose, around, target).best(self._commands)
        return float(speed), float(turn)


def make_for(
    points: NDArray[np.float32], pose: Pose, around: Surroundings
) -> NDArray[np.float64] | None:
    """Return the point of a path to make for; None at its end, or when it is empty.

    It is the furthest one within `LOOK_AHEAD` to which the robot fits straight: one
    behind a corner would hold it there.
    """
    if len(points) == 0:
        return None
    away = np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y)
    if away[-1] < NEAR_GOAL:
        return None
    nearest = int(away.argmin())
    far = np.nonzero(away[nearest:] >= LOOK_AHEAD)[0]
    last = nearest + int(far[0]) if len(far) else len(points) - 1
    ahead = points[nearest : last + 1].astype(float)
    share = np.linspace(0, 1, 15)
    x = pose.x + (ahead[:, :1] - pose.x) * share
    y = pose.y + (ahead[:, 1:] - pose.y) * share
    straight = np.nonzero(around.is_wide(around.clearance(x, y)))[0]
    index = int(straight[-1]) if len(straight) else min(2, len(ahead) - 1)
    return np.asarray(ahead[index])
