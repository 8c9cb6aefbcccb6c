"""Predicts how far the belt runs: its speed swings slowly."""

from __future__ import annotations

from collections import deque

import numpy as np

from poise import Component, Provided, Stamp, subscribed
from sorter.messages import Belt, Tracks

SPEEDS = 15
"""A line is laid through the last speeds."""


class BeltPredictor(Component):
    """Answers from the speeds that the tracker has told."""

    belt: Provided[Belt]

    def configure(self) -> None:
        self._speeds: deque[tuple[float, float]] = deque(maxlen=SPEEDS)

    @subscribed(keep=2)
    def tracks(self, message: Tracks) -> None:
        self._speeds.append((message.taken.at, message.speed))

    def travel(self, taken: Stamp, ahead: list[float]) -> list[float]:
        age = self.clock.since(taken)
        if age is None or len(self._speeds) < SPEEDS:
            return []
        moments, speeds = np.array(self._speeds).T
        rise, speed = np.polyfit(moments - taken.at, speeds, 1)
        until = age.value + np.array(ahead)
        return [float(way) for way in (speed + rise * until / 2) * until]
