"""The simulated flat as MuJoCo takes it: walls, furniture, the robot, a cup."""

from __future__ import annotations

import math

from trot import home
from trot.arm import arm_model

STEP = 0.002
"""[s] A step of the physics."""

LASER_HEIGHT = 0.25
"""[m]"""

EYE_HEIGHT = 1.0
"""[m] Above the furniture, below the walls' tops."""

_WALL_HEIGHT, _FURNITURE_HEIGHT = 2.4, 0.8
_HULL = 0.23
"""[m] Half the height of the robot's hull."""


def flat(walls: tuple[home.Segment, ...], furniture: tuple[home.Box, ...]) -> str:
    """Return the model. The laser sees group 0: walls and furniture.

    Parameters
    ----------
    walls, furniture
        As in `trot.home`.
    """
    obstacles = [_wall(each) for each in walls] + [_box(each) for each in furniture]
    x, y = arm_model.PLACES["left"]
    half = arm_model.CUP_HEIGHT / 2
    motors = "".join(
        f'<position joint="{name}" kp="150" kv="10"/>' for name in arm_model.JOINTS
    )
    return f"""
<mujoco>
 <option timestep="{STEP}" integrator="implicitfast"/>
 {arm_model.DEFAULTS}
 <worldbody>
  <geom name="floor" type="plane" size="20 20 1" contype="2" conaffinity="4" group="1"/>
  {"".join(obstacles)}
  <body name="robot">
   <joint name="x" type="slide" axis="1 0 0" damping="0"/>
   <joint name="y" type="slide" axis="0 1 0" damping="0"/>
   <joint name="heading" axis="0 0 1" damping="0"/>
   <geom name="hull" type="cylinder" size="{home.ROBOT_RADIUS} {_HULL}" mass="50"
    pos="0 0 {_HULL + 0.01}" contype="0" conaffinity="1" group="1"/>
   {arm_model.parts()}
  </body>
  <body name="cup" pos="{x} {y} {arm_model.TRAY_HEIGHT + half}">
   <freejoint/>
   <geom name="cup" type="cylinder" size="{arm_model.CUP_RADIUS} {half}" mass="0.15"
    contype="4" conaffinity="6" group="1" friction="1" condim="4"/>
  </body>
 </worldbody>
 <equality><weld name="grip" body1="hand" body2="cup" active="false"/></equality>
 <actuator>{motors}</actuator>
</mujoco>"""


def _wall(wall: home.Segment) -> str:
    ax, ay, bx, by = wall
    half = _WALL_HEIGHT / 2
    long = math.hypot(bx - ax, by - ay) / 2 + home.WALL_RADIUS
    return (
        f'<geom type="box" size="{long} {home.WALL_RADIUS} {half}" conaffinity="0" '
        f'pos="{(ax + bx) / 2} {(ay + by) / 2} {half}" '
        f'euler="0 0 {math.atan2(by - ay, bx - ax)}"/>'
    )


def _box(box: home.Box) -> str:
    left, bottom, right, top = box
    half = _FURNITURE_HEIGHT / 2
    return (
        f'<geom type="box" conaffinity="0" '
        f'size="{(right - left) / 2} {(top - bottom) / 2} {half}" '
        f'pos="{(left + right) / 2} {(bottom + top) / 2} {half}"/>'
    )
