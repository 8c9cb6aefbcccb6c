"""The robot's head: a neck that turns, and how well it looks at who speaks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

TURN = 3.0
"""[rad/s] at most."""


class Head:
    """Follows the angle that it is told, as quickly as it can."""

    def __init__(self) -> None:
        self.angle = 0.0
        """[rad] from the robot's heading, counter-clockwise."""
        self.wanted = 0.0
        self._off: list[float] = []

    def step(self, passed: float) -> None:
        """Turn for `passed` [s]."""
        left = math.remainder(self.wanted - self.angle, 2 * math.pi)
        self.angle += max(-TURN * passed, min(TURN * passed, left))

    def judge(self, bearing: float) -> None:
        """Note how far the head is from where somebody ended a sentence [rad]."""
        self._off.append(abs(math.remainder(self.angle - bearing, 2 * math.pi)))

    def result(self) -> dict[str, Any]:
        """Return how far the head was off at the ends of sentences [degrees]."""
        off = np.degrees(self._off)
        return {
            "head_error_degrees": round(float(np.median(off)), 1) if len(off) else None
        }
