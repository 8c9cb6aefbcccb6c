"""How the arm is built, for MuJoCo: in the simulated world and in the robot's head.

Lengths in [m] in the robot's frame: x ahead, y to the left, z up from the floor. The
arm stands behind a tray on top of the robot. A tall bottle stands in the middle of the
tray, and a cup to its left or to its right.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

JOINTS = ("turn", "shoulder", "elbow", "roll", "wrist", "hand")
"""From the base on. Positive angles of shoulder, elbow and wrist bend down."""

REST = (0.0, -1.9, 2.1, 0.0, 1.37, 0.0)
"""[rad] The hand is behind and above the bottle and points down."""

TRAY_HEIGHT = 0.5
TRAY = (0.09, 0.0)
"""x and y of the tray's middle."""
TRAY_HALF = (0.11, 0.19)
BOTTLE_RADIUS, BOTTLE_HEIGHT = 0.02, 0.16
CUP_RADIUS, CUP_HEIGHT = 0.03, 0.08
GRIP_ABOVE = 0.05
"""How far above the tray the hand grips a cup that stands on it."""
PLACES = {"left": (0.09, 0.12), "right": (0.09, -0.12)}
"""Where a cup may stand: x and y of the middle of its coaster."""

_ARM = """
<body name="turn" gravcomp="1" pos="-0.15 0 0.62">
 <joint name="turn" axis="0 0 1" range="-2.6 2.6"/>
 <geom class="arm" type="cylinder" size="0.035 0.03" pos="0 0 -0.03"/>
 <body name="upper" gravcomp="1">
  <joint name="shoulder" axis="0 1 0" range="-2.2 1.6"/>
  <geom class="arm" fromto="0.03 0 0 0.21 0 0"/>
  <body name="fore" gravcomp="1" pos="0.24 0 0">
   <joint name="elbow" axis="0 1 0" range="0 2.7"/>
   <geom class="arm" fromto="0 0 0 0.09 0 0"/>
   <body name="roll" gravcomp="1" pos="0.1 0 0">
    <joint name="roll" axis="1 0 0" range="-1.6 1.6"/>
    <geom class="arm" fromto="0 0 0 0.09 0 0"/>
    <body name="wrist" gravcomp="1" pos="0.1 0 0">
     <joint name="wrist" axis="0 1 0" range="-1.9 1.9"/>
     <geom class="arm" size="0.018" fromto="0 0 0 0.03 0 0"/>
     <body name="hand" gravcomp="1" pos="0.04 0 0">
      <joint name="hand" axis="1 0 0" range="-3 3"/>
      <geom class="arm" type="box" size="0.01 0.012 0.03" pos="0.01 0 0"/>
      {held}
      <site name="grip" pos="0.07 0 0"/>
     </body></body></body></body></body></body>
"""

_HELD = (
    f'<geom name="held" type="cylinder" size="{CUP_RADIUS} {CUP_HEIGHT / 2}" '
    f'pos="{0.07 + GRIP_ABOVE - CUP_HEIGHT / 2} 0 0" quat="0.7071 0 0.7071 0" '
    'contype="4" conaffinity="2"/>'
)

DEFAULTS = """
<compiler angle="radian"/>
<default>
 <joint damping="2" armature="0.02"/>
 <default class="arm">
  <geom type="capsule" size="0.022" mass="0.2" contype="4" conaffinity="2" group="1"/>
 </default>
 <default class="tray">
  <geom contype="2" conaffinity="6" group="1" friction="1"/>
 </default>
</default>
"""
"""Collide: arm and cup with tray and bottle, the cup with the arm too."""


def parts(*, carries: bool = False) -> str:
    """Return tray, bottle and arm as bodies in the robot's frame.

    Parameters
    ----------
    carries
        Whether a cup is fixed to the hand.
    """
    x, y = TRAY
    middle = TRAY_HEIGHT + BOTTLE_HEIGHT / 2
    return (
        f'<geom class="tray" type="box" name="tray" pos="{x} {y} {TRAY_HEIGHT - 0.01}" '
        f'size="{TRAY_HALF[0]} {TRAY_HALF[1]} 0.01"/>'
        f'<geom class="tray" type="cylinder" name="bottle" pos="{x} {y} {middle}" '
        f'size="{BOTTLE_RADIUS} {BOTTLE_HEIGHT / 2}"/>'
        + _ARM.format(held=_HELD if carries else "")
    )


class ArmModel:
    """The arm as the robot knows it: where the hand is, and what the arm touches.

    Parameters
    ----------
    carries
        Whether it holds a cup.
    """

    def __init__(self, *, carries: bool = False) -> None:
        self._model = mujoco.MjModel.from_xml_string(
            f"<mujoco>{DEFAULTS}<worldbody>{parts(carries=carries)}</worldbody></mujoco>"
        )
        self._data = mujoco.MjData(self._model)
        self._grip = self._model.site("grip").id

    @property
    def limits(self) -> NDArray[np.float64]:
        """The lowest and highest angle of each joint [rad], ``(6, 2)``."""
        return np.asarray(self._model.jnt_range)

    def hand(self, angles: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return where the hand grips [m] and where it points, ``(3,)`` each."""
        self._bend(angles)
        matrix = self._data.site_xmat[self._grip].reshape(3, 3)
        return self._data.site_xpos[self._grip].copy(), matrix[:, 0].copy()

    def touches(self, angles: NDArray[np.float64]) -> bool:
        """Return whether the arm, or what it holds, touches tray or bottle."""
        self._bend(angles)
        mujoco.mj_collision(self._model, self._data)
        return bool(self._data.ncon > 0)

    def solve(
        self,
        target: NDArray[np.float64],
        start: NDArray[np.float64],
        iterations: int = 60,
    ) -> NDArray[np.float64]:
        """Return angles [rad] with the hand at `target` [m], pointing straight down.

        Damped least squares with MuJoCo's Jacobian, from the angles `start`.
        """
        angles = np.array(start, float)
        turn, move = np.zeros((3, 6)), np.zeros((3, 6))
        down = np.array([0.0, 0.0, -1.0])
        for _ in range(iterations):
            place, axis = self.hand(angles)
            error = np.concatenate([target - place, 0.3 * np.cross(axis, down)])
            if np.abs(error).max() < 1e-4:
                break
            mujoco.mj_jacSite(self._model, self._data, move, turn, self._grip)
            jacobian = np.vstack([move, 0.3 * turn])
            square = jacobian @ jacobian.T + 1e-4 * np.eye(6)
            step = jacobian.T @ np.linalg.solve(square, error)
            angles += np.clip(step, -0.3, 0.3)
            angles = np.clip(angles, *self.limits.T)
        return angles

    def off(self, target: NDArray[np.float64], angles: NDArray[np.float64]) -> float:
        """Return how far [m] the hand is from `target`; `inf` when it is askew."""
        place, axis = self.hand(angles)
        is_down = axis[2] < -math.cos(0.15)
        return float(np.linalg.norm(target - place)) if is_down else math.inf

    def _bend(self, angles: NDArray[np.float64]) -> None:
        self._data.qpos[:] = angles
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
