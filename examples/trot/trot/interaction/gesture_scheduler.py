"""Goes along with what the robot says and hears: gestures of the hand."""

from __future__ import annotations

import math

import numpy as np

from poise import Component, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Attention, Gesture, Sentence

URGENT = 0.3
"""Attention more urgent than this is pointed to."""

REACH = 0.45
"""[m]"""


class GestureScheduler(Component):
    """Points to where somebody speaks, and raises the hand while the robot speaks."""

    gesture: Published[Gesture]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._attention = Attention(0.0, 0.0, 0.0)
        self._speaks_until = -math.inf

    @subscribed(keep=1)
    def attention(self, message: Attention) -> None:
        self._attention = message

    @subscribed(keep=1)
    def sentence(self, message: Sentence) -> None:
        self._speaks_until = self.clock.now() + 0.06 * len(message.text)

    @every(0.2)
    def schedule(self) -> None:
        self._effort.spend(_overlaps, self._effort.start())
        now = self.clock.now()
        points = self._attention.urgency > URGENT
        bearing = self._attention.bearing if points else 0.0
        bearing = max(-1.0, min(1.0, bearing))
        height = 0.25 if now < self._speaks_until else 0.05
        x, y = REACH * math.cos(bearing), REACH * math.sin(bearing)
        self.gesture.publish(Gesture(now, x, y, height))


def _overlaps(block: Block) -> int:
    """Count the pairs of many planned gestures that overlap in time."""
    start, length = np.sort(block[:4096]), block[4096:8192] * 1e-3
    return int(np.searchsorted(start, start + length).sum())
