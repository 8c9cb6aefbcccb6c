"""How the arm is built: six joints, and where its parts are when they bend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

JOINTS = 6
LINKS = np.array([0.10, 0.28, 0.06, 0.24, 0.06, 0.08], np.float64)
"""Length of the link after each joint [m]."""

Angles = NDArray[np.float32] | NDArray[np.float64]
"""One angle per joint [rad], ``(..., JOINTS)``."""


def points(angles: Angles) -> NDArray[np.float64]:
    """Return the end of each link x, y, z [m], ``(..., JOINTS, 3)``.

    The first joint turns the arm about the upright axis, the others bend it in its
    plane; the shoulder is the origin.
    """
    bend = np.cumsum(angles[..., 1:], axis=-1, dtype=float)
    bend = np.concatenate([np.zeros_like(bend[..., :1]), bend], axis=-1)
    reach = np.cumsum(LINKS * np.cos(bend), axis=-1)
    height = np.cumsum(LINKS * np.sin(bend), axis=-1)
    turn = angles[..., :1].astype(float)
    return np.stack([reach * np.cos(turn), reach * np.sin(turn), height], axis=-1)


def hand(angles: Angles) -> NDArray[np.float64]:
    """Return where the hand is [m], ``(..., 3)``."""
    return np.asarray(points(angles)[..., -1, :])
