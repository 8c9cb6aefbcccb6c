"""The camera above the tray: what it sees of a point in the robot's frame.

It looks straight down from `HEIGHT` above the floor, with the robot's front at the
right edge of the picture and its left side at the top.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trot.arm import arm_model

ROWS, COLUMNS = 480, 640
HEIGHT = 1.3
"""[m]"""

FOCAL = 900.0
"""[pixels]"""

MIDDLE = arm_model.TRAY
"""x and y [m] of the point below it."""


def pixel(x: float, y: float, height: float) -> NDArray[np.float64]:
    """Return column and row of a point [m] at `height` [m] above the floor."""
    scale = FOCAL / (HEIGHT - height)
    return np.array(
        [COLUMNS / 2 + (x - MIDDLE[0]) * scale, ROWS / 2 - (y - MIDDLE[1]) * scale]
    )


def place(column: float, row: float, height: float) -> tuple[float, float]:
    """Return x and y [m] of a pixel, when what it shows is at `height` [m]."""
    scale = (HEIGHT - height) / FOCAL
    return (
        MIDDLE[0] + (column - COLUMNS / 2) * scale,
        MIDDLE[1] - (row - ROWS / 2) * scale,
    )


def pixels_of(length: float, height: float) -> float:
    """Return how many pixels a length [m] takes at `height` [m]."""
    return length * FOCAL / (HEIGHT - height)
