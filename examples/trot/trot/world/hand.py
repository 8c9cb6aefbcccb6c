"""The simulated arm's motors and hand, and the cup that it grips."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trot.arm import arm_model

REACH = 0.02
"""[m] A hand that closes this near the middle of a cup's grip holds it."""

ON_PLACE = 0.03
"""[m] A cup this near a place stands on it."""

UPRIGHT = 0.95
"""The cosine of how far a cup may lean."""

LIES = 2.0
"""[s] A cup that fell is put back on its last place after this time."""


_SEEN = ("turn", "fore", "wrist", "hand")


class Hand:
    """Six motors that follow the angles they are told, and a gripper."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        start = model.joint(arm_model.JOINTS[0]).qposadr[0]
        self._joints = slice(start, start + len(arm_model.JOINTS))
        data.qpos[self._joints] = data.ctrl[:] = arm_model.REST
        self._cup = model.joint(model.body("cup").jntadr[0]).qposadr[0]
        self._weld = model.equality("grip").id
        self.place, self.placed, self.dropped = "left", 0, 0
        """Where the cup was last, how often it was brought, how often it fell."""
        self._lies = 0.0
        self._put()

    @property
    def angles(self) -> NDArray[np.float64]:
        """Of the joints [rad], ``(6,)``."""
        return np.array(self._data.qpos[self._joints])

    @property
    def is_closed(self) -> bool:
        """Whether the hand holds the cup."""
        return bool(self._data.eq_active[self._weld])

    @property
    def cup(self) -> tuple[NDArray[np.float64], float]:
        """The cup's middle in the robot's frame [m], and how upright it is, 1 at most.

        The frame is that of `arm_model`.
        """
        where = self._data.xpos[self._model.body("cup").id]
        rotation = self._data.xmat[self._model.body("robot").id].reshape(3, 3)
        robot = self._data.xpos[self._model.body("robot").id]
        lean = self._data.xmat[self._model.body("cup").id][8]
        return rotation.T @ (where - robot), float(lean)

    @property
    def points(self) -> list[NDArray[np.float64]]:
        """The arm's joints and the hand in the robot's frame [m]."""
        robot = self._data.body("robot")
        rotation = robot.xmat.reshape(3, 3)
        places = [self._data.body(name).xpos for name in _SEEN]
        places.append(self._data.site("grip").xpos)
        return [rotation.T @ (place - robot.xpos) for place in places]

    def move(self, angles: NDArray[np.float64], *, closed: bool) -> None:
        """Tell the motors where to turn [rad], and the hand whether to be closed."""
        self._data.ctrl[:] = angles
        if closed and not self.is_closed and self._is_around():
            self._grip()
        elif not closed:
            self._data.eq_active[self._weld] = 0

    def follow(self, passed: float) -> None:
        """See where the cup is now, `passed` [s] after the last time."""
        place, lean = self.cup
        if self.is_closed:
            return
        stands = place[2] - arm_model.TRAY_HEIGHT < arm_model.CUP_HEIGHT / 2 + 0.01
        if lean < UPRIGHT or place[2] < arm_model.TRAY_HEIGHT:
            self._lies += passed
            if self._lies > LIES:
                self.dropped += 1
                self._put()
        elif stands:
            for name, spot in arm_model.PLACES.items():
                if name != self.place and np.hypot(*(place[:2] - spot)) < ON_PLACE:
                    self.place = name
                    self.placed += 1

    def _is_around(self) -> bool:
        """Whether the hand is where it can grip the cup."""
        middle, lean = self.cup
        above = arm_model.GRIP_ABOVE - arm_model.CUP_HEIGHT / 2
        site = self._data.site("grip").xpos - self._data.body("robot").xpos
        rotation = self._data.body("robot").xmat.reshape(3, 3)
        off = rotation.T @ site - middle - np.array([0, 0, above])
        return lean > UPRIGHT and float(np.linalg.norm(off)) < REACH

    def _grip(self) -> None:
        """Hold the cup as it is in the hand now."""
        hand, cup = self._data.body("hand"), self._data.body("cup")
        back = np.zeros(4)
        mujoco.mju_negQuat(back, hand.xquat)
        turned = np.zeros(4)
        mujoco.mju_mulQuat(turned, back, cup.xquat)
        moved = np.zeros(3)
        mujoco.mju_rotVecQuat(moved, cup.xpos - hand.xpos, back)
        self._model.eq_data[self._weld][:3] = 0
        self._model.eq_data[self._weld][3:10] = (*moved, *turned)
        self._data.eq_active[self._weld] = 1

    def _put(self) -> None:
        """Put the cup upright on its last place."""
        self._lies = 0.0
        x, y, heading = self._data.qpos[:3]
        ahead, left = arm_model.PLACES[self.place]
        cosine, sine = np.cos(heading), np.sin(heading)
        height = arm_model.TRAY_HEIGHT + arm_model.CUP_HEIGHT / 2 + 0.001
        self._data.qpos[self._cup : self._cup + 7] = (
            x + cosine * ahead - sine * left,
            y + sine * ahead + cosine * left,
            height,
            *(1, 0, 0, 0),
        )
        speed = self._model.body("cup").dofadr[0]
        self._data.qvel[speed : speed + 6] = 0
