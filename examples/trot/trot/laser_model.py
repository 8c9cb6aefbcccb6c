"""What is known of the laser range finder, to the simulator and to the robot."""

from __future__ import annotations

import math

import numpy as np

BEAMS = 270
PERIOD = 0.1
"""[s] from scan to scan."""

MAX_RANGE = 6.0
"""[m] A beam that hits nothing nearer reads this."""

NOISE = 0.01
"""[m] standard deviation of a range."""

ANGLES = np.linspace(-0.75 * math.pi, 0.75 * math.pi, BEAMS, dtype=np.float64)
"""Direction of each beam [rad], relative to the robot's heading, ``(BEAMS,)``."""
