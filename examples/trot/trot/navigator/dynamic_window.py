"""Speed and turn rate: of many commands, tried out on the map, take the best.

After Fox, Burgard and Thrun: The dynamic window approach to collision avoidance (1997).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trot.messages import Pose
from trot.navigator import grid
from trot.navigator.surroundings import Surroundings

MAX_SPEED = 0.7
"""[m/s]"""

MAX_TURN = 1.4
"""[rad/s]"""

BACKWARDS = -0.15
"""[m/s]"""

HORIZON = 1.2
"""[s] How far ahead a command is tried out."""

STEPS = 16
"""Points that are looked at within the horizon."""

Commands = NDArray[np.float64]
"""Speed [m/s] and turn rate [rad/s], ``(n, 2)``."""


class Trial:
    """Tries commands out: where they lead from `pose`, and what is in the way."""

    def __init__(
        self, pose: Pose, around: Surroundings, target: NDArray[np.float64]
    ) -> None:
        self._pose = pose
        self._target = target
        self._around = around

    def best(self, commands: Commands) -> NDArray[np.float64]:
        """Return the command with the highest score; standing still when none is safe.

        The score wants to come near the target, to look at it, to keep clear of
        obstacles, and to move on.
        """
        x, y, heading = self._lead(commands)
        room = self._around.clearance(x, y)
        dx, dy = self._target[0] - x[:, -1], self._target[1] - y[:, -1]
        off = np.abs(_wrapped(np.arctan2(dy, dx) - heading[:, -1]))
        score = (
            -1.0 * np.hypot(dx, dy).clip(0.1)
            - 0.25 * off * np.minimum(1.0, np.hypot(dx, dy) / 0.3)
            + 0.5 * np.minimum(room, 0.4)
            + 0.1 * commands[:, 0]
        )
        moving = np.abs(commands[:, 0]) > 0.01
        score[moving & ~self._around.is_wide(room)] = -np.inf
        return np.asarray(commands[int(score.argmax())])

    def _lead(self, commands: Commands) -> tuple[grid.Floats, grid.Floats, grid.Floats]:
        """Return x, y [m] and heading [rad] along each command, ``(n, STEPS)``."""
        speed, turn = commands[:, :1], commands[:, 1:]
        step = HORIZON / STEPS
        heading = self._pose.heading + turn * step * np.arange(1, STEPS + 1)
        middle = heading - turn * step / 2
        x = self._pose.x + np.cumsum(speed * step * np.cos(middle), axis=1)
        y = self._pose.y + np.cumsum(speed * step * np.sin(middle), axis=1)
        return x, y, heading


def lattice(speeds: int, turns: int) -> Commands:
    """Return commands over the whole window of speeds and turn rates, some backwards.

    Parameters
    ----------
    speeds, turns
        How many different ones.
    """
    ahead = np.linspace(0, MAX_SPEED, speeds - 1)
    across = np.linspace(-MAX_TURN, MAX_TURN, turns)
    pairs = np.meshgrid(np.append(ahead, BACKWARDS), across)
    return np.stack(pairs, axis=-1).reshape(-1, 2)


def _wrapped(angle: grid.Floats) -> grid.Floats:
    """Return the same angle within -pi and pi [rad]."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
