"""Decides what the hand does next to bring the cup to the other side of the tray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from trot.arm import arm_model
from trot.arm.arm_model import ArmModel
from trot.messages import Cup, Joints, Order, Reach

ABOVE = 0.2
"""[m] above the tray: the cup that the hand holds here passes above the bottle."""

PLAY = 0.004
"""[m] between the tray and a cup that is put down, before it is let go."""

TRIES = 8
"""Postures from which the inverse kinematics begins, at most."""

WORTH_LOOKING = 0.3
"""[s] A cup that was seen earlier than this is looked for again."""

ON_PLACE = 0.05
"""[m] A cup that is seen this near its place stands there."""

PATIENCE = 5.0
"""[s] A reach that takes longer is given up, and the cup is looked for anew."""

STEPS = ("over cup", "at cup", "lift", "over place", "at place", "leave")
_HOLDS = {"lift", "over place", "at place"}
_CLOSES = {"at cup", "lift", "over place"}


class GraspPlanner(Component):
    """Takes the cup from where it is seen to where it is ordered.

    With no order it goes on with the other place: the robot shows that it can. That the
    cup was placed ends the action of a task.
    """

    reach: Published[Reach]
    placed: Published[bool]

    def configure(self) -> None:
        self._random = np.random.default_rng(0)
        self._arm = ArmModel()
        self._cup: Cup | None = None
        self._from = (0.0, 0.0)
        self._goal = ""
        self._ordered = ""
        self._step = len(STEPS)
        self._number = 0
        self._since = self.clock.now()
        self._is_asked = self._rests = False

    def begin(self, _: str) -> None:
        """Bring the cup to the other side once, and rest then."""
        self._is_asked, self._rests = True, False

    @subscribed(keep=1)
    def cup(self, message: Cup) -> None:
        self._cup = message

    @subscribed(keep=1)
    def order(self, message: Order) -> None:
        self._ordered = message.side

    @subscribed(keep=1)
    def joints(self, message: Joints) -> None:
        """Go on when the arm has done the last reach, or has not had one yet."""
        is_late = self.clock.now() - self._since > PATIENCE
        if message.done != self._number and not is_late:
            return
        if is_late:
            self._step = len(STEPS)
        elif self._step == len(STEPS) and self._number:
            self._judge()
        if self._step >= len(STEPS) and not self._begin():
            return
        self._next(message.angles.astype(float))

    def _judge(self) -> None:
        """Say whether the cup stands on its place, once the camera sees it."""
        goal = arm_model.PLACES[self._goal]
        if self._cup is not None and self._cup.stamp > self._since:
            off = np.hypot(self._cup.x - goal[0], self._cup.y - goal[1])
            self._step += 1
            self._rests = self._is_asked and bool(off < ON_PLACE)
            self.placed.publish(bool(off < ON_PLACE))

    def _begin(self) -> bool:
        """Choose where to take the cup; whether there is one to take."""
        if self._rests or self._cup is None:
            return False
        if self.clock.now() - self._cup.stamp > WORTH_LOOKING:
            return False
        self._from = self._cup.x, self._cup.y
        places = arm_model.PLACES
        here = min(
            places, key=lambda p: float(np.hypot(*np.subtract(places[p], self._from)))
        )
        if self._ordered == here:
            self._ordered = ""
        (other,) = set(places) - {here}
        self._goal, self._ordered, self._step = self._ordered or other, "", 0
        return True

    def _next(self, angles: NDArray[np.float64]) -> None:
        """Publish the next step's reach, or give up when the arm cannot do it."""
        step = STEPS[self._step]
        x, y = self._from if self._step < 3 else arm_model.PLACES[self._goal]
        low = step in {"at cup", "at place"}
        height = arm_model.GRIP_ABOVE + PLAY if low else ABOVE
        target = np.array([x, y, arm_model.TRAY_HEIGHT + height])
        posture = self._solve(target, angles)
        if posture is None:
            self.log.info("no posture of the arm reaches %s", target)
            self._step = len(STEPS)
            return
        self._number += 1
        self._step += 1
        self._since = self.clock.now()
        self.reach.publish(
            Reach(
                self.clock.now(),
                self._number,
                posture.astype(np.float32),
                carries=step in _HOLDS,
                closes=step in _CLOSES,
            )
        )

    def _solve(
        self, target: NDArray[np.float64], start: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return angles [rad] that bring the hand to `target` [m]."""
        for number in range(TRIES):
            spread = 0.4 * number * self._random.normal(0, 1, 6)
            begin = np.clip(start + spread, *self._arm.limits.T)
            angles = self._arm.solve(target, begin)
            is_free = not self._arm.touches(angles)
            if is_free and self._arm.off(target, angles) < 0.005:
                return angles
        return None
