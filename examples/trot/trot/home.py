"""The home that T-Rot lives in: its walls, its furniture, where to start and to go.

Seen from above [m], x to the right and y up; the robot starts in the bedroom, passes
two doors and ends in the kitchen::

    6 +-----------+------------+-----------+
      | bed       |            |           |
      |           door         |           |
    3 |  start    |   chair    |           |
      |           |            door        |
      |           | sofa       |     goal  |
    0 +-----------+------------+-----------+
      0           3           5.5          8
"""

from __future__ import annotations

Segment = tuple[float, float, float, float]
"""x and y [m] of one end, x and y of the other."""

Box = tuple[float, float, float, float]
"""Left, bottom, right, top [m]."""

WALL_RADIUS = 0.05
"""Half the thickness of a wall [m]."""

WALLS: tuple[Segment, ...] = (
    (0, 0, 8, 0),
    (8, 0, 8, 6),
    (8, 6, 0, 6),
    (0, 6, 0, 0),
    (3, 0, 3, 3.9),
    (3, 4.9, 3, 6),
    (5.5, 0, 5.5, 1.6),
    (5.5, 2.6, 5.5, 6),
)
"""What the robot knows before it starts."""

FURNITURE: tuple[Box, ...] = (
    (0.05, 4.7, 1.2, 5.95),
    (3.2, 0.3, 4.0, 1.6),
    (4.0, 3.0, 4.4, 3.4),
    (7.4, 3.2, 7.95, 5.0),
)
"""What it must find with its laser: bed, sofa, chair and cupboard."""

START = (1.6, 2.8, 0.6)
"""x [m], y [m] and heading [rad, counter-clockwise from the x axis]."""

GOAL = (6.8, 1.2)
"""x and y [m]."""

GOAL_RADIUS = 0.25
"""[m] The robot is there when its centre is this near."""

ROBOT_RADIUS = 0.25
"""[m]"""
