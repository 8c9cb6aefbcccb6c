"""Where the person is: in a chair, and on the way to the kitchen when asked to lead."""

from __future__ import annotations

import numpy as np

from trot.world.sound import PERSON, Place

ROUTE: tuple[Place, ...] = (PERSON, (5.5, 2.1), (6.6, 2.3), (6.6, 4.6))
"""Through the kitchen's door."""

SPEED = 0.35
"""[m/s]"""

_AT = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ROUTE, axis=0), axis=1))])
LENGTH = float(_AT[-1])
"""[m]"""


class Walk:
    """The person's way so far."""

    def __init__(self) -> None:
        self.is_leading = False
        """Whether the robot said that it follows."""
        self.walked = 0.0
        """[m]"""

    def step(self, passed: float) -> None:
        """Let `passed` [s] go by."""
        if self.is_leading:
            self.walked = min(LENGTH, self.walked + SPEED * passed)

    @property
    def is_walking(self) -> bool:
        """Whether the person is on the way."""
        return 0 < self.walked < LENGTH

    @property
    def place(self) -> Place:
        """Where the person is [m]."""
        xs, ys = zip(*ROUTE, strict=True)
        x, y = np.interp(self.walked, _AT, xs), np.interp(self.walked, _AT, ys)
        return float(x), float(y)
