"""Where T-Rot's microphones are."""

from __future__ import annotations

import numpy as np

from trot.packets import MICROPHONES

RADIUS = 0.1
"""[m] of the circle that they are on."""

_ANGLES = np.pi / 4 + np.arange(MICROPHONES) * 2 * np.pi / MICROPHONES
MICROPHONES_AT = RADIUS * np.array([np.cos(_ANGLES), np.sin(_ANGLES)])
"""Ahead and to the left of the robot's middle [m], ``(2, MICROPHONES)``."""
