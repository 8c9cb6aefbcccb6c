"""Decides which object the arm takes, and moves the hand along with it."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from poise import CallError, Component, Published, Required, Stamp, subscribed
from sorter import arm_model, cell
from sorter.messages import STEP, Belt, Defects, Grip, Guard, Motion, Tracks

AHEAD = [STEP * step for step in range(24)]
"""[s] from now: a motion has a posture for each."""

REACH, SINK, HOLD, LIFT, CARRY = 0.6, 0.25, 0.08, 0.15, 0.75
"""[s] to come over an object; from there down to it; until the hand has closed; up; and
to the bin."""

SOON = 1.2
"""[s] An object that takes longer to the zone is waited for."""

SAME = 0.05
"""[m] A scratch this near an object is the object's."""


class Pick(Struct):
    """An object that is being taken: the hand closes and opens at these times [s]."""

    number: int
    colour: str
    closes: float
    opens: float


class GraspPlanner(Component):
    """Publishes the next 0.7 s of the arm's motion whenever the tracks are new.

    `done` ends the task's action, after as many objects as the parameter `objects`.
    """

    motion: Published[Motion]
    grip: Published[Grip]
    done: Published[bool]
    belt: Required[Belt]

    def configure(self) -> None:
        self._objects = int(self.parameters.get("objects", 6))
        self._sorted = 0
        self._pick: Pick | None = None
        self._picked: set[int] = set()
        self._defects: list[tuple[float, float]] = []
        self._scratched: set[int] = set()
        self._holds = False
        self._angles = arm_model.REST

    def begin(self, _: str) -> None:
        self._sorted = 0

    @subscribed(keep=1)
    def defects(self, message: Defects) -> None:
        for way in self._travel(message.taken, [0.0]):
            self._defects = [(float(x) + way, float(y)) for x, y in message.places]

    @subscribed(keep=4)
    def held(self, message: bool) -> None:  # noqa: FBT001, a message's content
        self._holds = message

    @subscribed(keep=1)
    def guard(self, message: Guard) -> None:
        """Let an object go by while somebody is near, or bring it later."""
        now = self.clock.now()
        if message.clear or self._pick is None:
            return
        if now < self._pick.closes:
            self._pick = None
        elif now < self._pick.opens:
            self._pick.opens = now + CARRY

    @subscribed(keep=1)
    def tracks(self, message: Tracks) -> None:
        if not (travel := self._travel(message.taken, AHEAD)):
            return
        now = self.clock.now()
        places = message.places.astype(float) + np.array([travel[0], 0.0])
        self._find_scratched(message.numbers, places)
        self._end(now)
        if self._pick is None:
            self._choose(now, message, places)
        at = self._place_of_pick(message.numbers, places)
        ways = np.array(travel) - travel[0]
        postures, angles = [], self._angles
        for ahead, way in zip(AHEAD, ways, strict=True):
            angles = arm_model.solve(self._target(now + ahead, at, way), angles)
            postures.append(angles)
        self._angles = postures[3]
        self.motion.publish(
            Motion(self.clock.stamp(now), np.array(postures, np.float32))
        )
        self._publish_grip(now)

    def _travel(self, taken: Stamp, ahead: list[float]) -> list[float]:
        try:
            return self.belt.travel(taken, ahead)
        except CallError as error:
            self.log.info("where the objects are is not known: %s", error)
            return []

    def _find_scratched(self, numbers: list[int], places: np.ndarray) -> None:
        for place in self._defects:
            away = np.hypot(*(places - place).T)
            if len(away) and away.min() < SAME:
                self._scratched.add(numbers[int(away.argmin())])
        self._defects = []

    def _end(self, now: float) -> None:
        """Be done with an object that is in its bin, or that the hand has missed."""
        pick = self._pick
        if pick is None:
            return
        if now > pick.opens + HOLD:
            self._pick = None
            self._sorted += 1
            if self._sorted == self._objects:
                self.done.publish(True)
        elif not self._holds and pick.closes + HOLD + LIFT < now < pick.opens:
            self._pick = None

    def _choose(self, now: float, tracks: Tracks, places: np.ndarray) -> None:
        """Take the first object that the hand can reach in its zone."""
        speed = max(tracks.speed, 0.02)
        for index in np.argsort(-places[:, 0]):
            number = tracks.numbers[index]
            x = places[index, 0]
            wait = max((cell.ZONE[0] + 0.05 - x) / speed, REACH)
            if number in self._picked or x + speed * wait > cell.ZONE[1]:
                continue
            if wait < SOON:
                closes = now + wait
                opens = closes + HOLD + LIFT + CARRY
                self._pick = Pick(number, tracks.colours[index], closes, opens)
            return

    def _place_of_pick(
        self, numbers: list[int], places: np.ndarray
    ) -> tuple[float, float]:
        """Return where the object is now; where the hand waits when there is none."""
        if self._pick is not None and self._pick.number in numbers:
            x, y = places[numbers.index(self._pick.number)]
            return float(x), float(y)
        return cell.ZONE[0] + 0.1, cell.BELT_Y

    def _target(
        self, moment: float, at: tuple[float, float], way: float
    ) -> tuple[float, float, float]:
        """Return where the hand is to be at a moment [m]."""
        pick = self._pick
        if pick is None:
            return (*at, cell.HOVER)
        if moment > pick.closes + HOLD + LIFT:
            return (*cell.BINS[self._bin(pick)], cell.HOVER)
        x = min(max(at[0] + way, cell.ZONE[0] - 0.05), cell.ZONE[1] + 0.05)
        ups = (pick.closes - SINK, pick.closes, pick.closes + HOLD)
        heights = (cell.HOVER, cell.ON_BELT, cell.ON_BELT, cell.HOVER)
        height = np.interp(moment, (*ups, ups[-1] + LIFT), heights)
        return x, at[1], float(height)

    def _bin(self, pick: Pick) -> str:
        return cell.REJECT if pick.number in self._scratched else pick.colour

    def _publish_grip(self, now: float) -> None:
        """Say when the hand closes or opens next."""
        pick, stamp = self._pick, self.clock.stamp(now)
        if pick is None:
            self.grip.publish(Grip(stamp, 0.0, closed=False))
        elif now < pick.closes:
            self._picked.discard(pick.number)
            self.grip.publish(Grip(stamp, pick.closes - now, closed=True))
        else:
            self._picked.add(pick.number)
            self.grip.publish(Grip(stamp, pick.opens - now, closed=False))
