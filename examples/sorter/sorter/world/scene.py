"""The cell: belt, objects, arm, hand and person. Steps as it is told, under a seed."""

from __future__ import annotations

import math
import random

import numpy as np
from msgspec import Struct

from sorter import arm_model, cell

STEP = 0.02
"""[s]"""

SPEED, SWING, TURN = 0.2, 0.06, 4.0
"""Of the belt: its mean speed [m/s], how much it swings [m/s], and how long that takes
[s]."""

GAP = (0.42, 0.5)
"""[m] between objects."""

SCRATCHED = 0.25
"""The share of objects with a scratch."""

GRASP = 0.018
"""[m] A hand that closes this near an object takes it."""

IN_BIN = 0.1
"""[m] An object that is let go this near the middle of a bin falls into it."""

VISITS = ((4.0, 6.0), (12.0, 14.0), (20.0, 22.0), (28.0, 30.0))
"""[s] Between these times somebody comes."""

FAR, NEAR, WALKS, STAYS = 4.0, 0.5, 1.6, 0.6
"""Somebody comes from far [m], so near [m], so fast [m/s], and stays so long [s]."""

HITS = 0.2
"""[rad/s] An arm that moves faster than this hits whoever is too near."""


class Thing(Struct):
    """An object, and its fate: the name of a bin, ``passed`` or ``dropped``."""

    x: float
    y: float
    colour: str
    round: bool
    angle: float
    scratch: float | None
    fate: str = ""


class Scene:
    """Everything in the cell."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.runs = False
        """Whether the belt has begun: the arm's first command starts it."""
        self.now = 0.0
        self.things: list[Thing] = []
        self.angles = arm_model.REST.copy()
        self.wanted = self.angles.copy()
        self.closed = False
        self.held: Thing | None = None
        self.grips, self.grips_held, self.collisions = 0, 0, 0
        self._phase = self._random.uniform(0, math.tau)
        self._visits = [self._random.uniform(*each) for each in VISITS]
        self._was_hit = False
        self._next = 0.0
        for x in (-0.3, -0.75):
            self._put(x)

    @property
    def speed(self) -> float:
        """Of the belt [m/s]."""
        swing = math.sin(math.tau * self.now / TURN + self._phase)
        return SPEED + SWING * swing if self.runs else 0.0

    @property
    def person(self) -> float:
        """How far the nearest person is [m]; infinite: there is none."""
        way = (FAR - NEAR) / WALKS
        for begin in self._visits:
            passed = self.now - begin
            if 0 <= passed <= 2 * way + STAYS:
                after = max(0.0, passed - way - STAYS)
                return max(NEAR, FAR - WALKS * passed) + WALKS * after
        return math.inf

    def step(self) -> None:
        """Let `STEP` pass."""
        before = self.angles
        most = arm_model.FASTEST * STEP
        self.angles = before + np.clip(self.wanted - before, -most, most)
        if not self.runs:
            return
        self.now += STEP
        way = self.speed * STEP
        for thing in self.things:
            if not thing.fate and thing is not self.held:
                thing.x += way
                if thing.x > cell.ZONE[1] + 0.1:
                    thing.fate = "passed"
        self._next -= way
        if self._next <= 0:
            self._put(cell.CORNER[0] - 2 * cell.OBJECT)
        fast = float(np.abs(self.angles - before).max()) / STEP > HITS
        is_hit = fast and self.person < cell.PERSON_TOO_NEAR
        self.collisions += is_hit and not self._was_hit
        self._was_hit = is_hit or (self._was_hit and self.person < math.inf)

    def command(self, angles: list[float]) -> None:
        """Turn the joints to these angles [rad]."""
        self.wanted, self.runs = np.array(angles), True

    def grip(self, *, closed: bool) -> None:
        """Close or open the hand."""
        if closed == self.closed:
            return
        self.closed = closed
        x, y, z, _ = arm_model.hand(self.angles)
        if not closed:
            if self.held is not None:
                self.held.fate = _bin_at(x, y)
                self.held = None
            return
        self.grips += 1
        for thing in self.things:
            middle = (thing.x, thing.y, cell.ON_BELT)
            if not thing.fate and math.dist((x, y, z), middle) < GRASP:
                self.held = thing
                self.grips_held += 1
                return

    def _put(self, x: float) -> None:
        draw = self._random
        self._next = draw.uniform(*GAP)
        self.things.append(
            Thing(
                x=x,
                y=cell.BELT_Y + draw.uniform(-cell.BELT_HALF, cell.BELT_HALF),
                colour=draw.choice(cell.COLOURS),
                round=draw.random() < 0.5,
                angle=draw.uniform(0, math.pi),
                scratch=draw.uniform(0, math.pi) if draw.random() < SCRATCHED else None,
            )
        )


def _bin_at(x: float, y: float) -> str:
    for name, middle in cell.BINS.items():
        if math.dist((x, y), middle) < IN_BIN:
            return name
    return "dropped"
