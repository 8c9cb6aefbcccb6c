"""What is known of the camera in the head, to the simulator and to the robot."""

from __future__ import annotations

import math

ROWS, COLUMNS = 240, 320
FOCAL = 277.0
"""[pixels] It sees 60 degrees."""

PERIOD = 0.2
"""[s] from picture to picture."""


def column(angle: float) -> float:
    """Return where it sees what is at `angle` [rad], counter-clockwise from ahead."""
    return COLUMNS / 2 - FOCAL * math.tan(angle)


def angle(column: float) -> float:
    """Return the direction [rad] of a column."""
    return math.atan((COLUMNS / 2 - column) / FOCAL)


def pixels_of(length: float, distance: float) -> float:
    """Return how many pixels a length [m] takes at a distance [m]."""
    return length * FOCAL / distance
