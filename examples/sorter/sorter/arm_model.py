"""The arm: a turning base and three joints in a plane, with the hand pointing down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

BASE = 0.25
"""Height of the shoulder [m]."""

LINKS = np.array([0.32, 0.30, 0.08])
"""Lengths of upper arm, forearm and hand [m]."""

REST = np.array([1.2, 0.9, -1.6, -0.87])
FASTEST = 4.0
"""[rad/s] of each joint."""

_LOW, _HIGH = np.array([[-3.0, -0.5, -2.7, -2.2], [3.0, 1.8, 0.0, 1.0]])
_COMFORT = 0.003
"""How much a radian away from the rest posture counts, in metres."""

Angles = NDArray[np.float64]


def hand(angles: Angles) -> NDArray[np.float64]:
    """Return x, y, z [m] and pitch [rad] of the hand."""
    pitches = np.cumsum(angles[1:])
    out, up = LINKS @ np.cos(pitches), BASE + LINKS @ np.sin(pitches)
    turn = angles[0]
    return np.array([out * np.cos(turn), out * np.sin(turn), up, pitches[-1]])


def solve(target: tuple[float, float, float], start: Angles) -> Angles:
    """Return the angles [rad] that bring the hand to `target` [m], pointing down.

    The search begins at `start`; of all postures it prefers those near `REST`.
    """
    goal = np.array([*target, -np.pi / 2])

    def off(angles: Angles) -> NDArray[np.float64]:
        return np.concatenate([hand(angles) - goal, _COMFORT * (angles[1:] - REST[1:])])

    begin = np.clip(start, _LOW + 1e-3, _HIGH - 1e-3)
    return np.asarray(least_squares(off, begin, bounds=(_LOW, _HIGH), xtol=1e-5).x)
