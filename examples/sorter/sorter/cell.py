"""Where things are in the cell [m]: the arm stands at 0, 0; the belt runs along x."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

COLOURS = ("red", "green", "blue")
REJECT = "reject"

BINS = {
    name: (0.4 * float(np.cos(angle)), 0.4 * float(np.sin(angle)))
    for name, angle in zip(
        (*COLOURS, REJECT), np.radians([5, -20, -45, -70]), strict=True
    )
}
"""Middles of the bins."""

BELT_Y = 0.35
BELT_HALF = 0.06
"""Objects lie this far from the middle of the belt, at most."""

ZONE = (0.0, 0.32)
"""x between which the arm takes objects from the belt."""

OBJECT = 0.03
"""Half the size of an object."""

ON_BELT, HOVER = 0.12, 0.24
"""Heights of the hand when it takes an object, and when it travels."""

WIDTH, HEIGHT, PIXEL = 400, 300, 0.002
"""Of the camera's picture [pixels], and of a pixel [m]."""

CORNER = (-0.85, 0.05)
"""x, y of the picture's first pixel."""

CAMERA_PERIOD, SCANNER_PERIOD = 0.1, 0.05
"""[s]"""

BEAMS = 360
"""Of the scanner that looks for people."""

PERSON_TOO_NEAR = 0.8
"""The arm stands still when a person is nearer than this, or has hit them."""


def place(pixels: Sequence[float] | NDArray[np.floating]) -> NDArray[np.float32]:
    """Return x, y [m] of columns and rows, ``(..., 2)``."""
    where = np.asarray(pixels, np.float64) * PIXEL + CORNER
    return np.asarray(where, np.float32)


def pixel(x: float, y: float) -> tuple[int, int]:
    """Return column and row of a place."""
    return round((x - CORNER[0]) / PIXEL), round((y - CORNER[1]) / PIXEL)
