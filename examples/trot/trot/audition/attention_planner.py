"""Decides where to look: active audition turns the head to hear better."""

from __future__ import annotations

import math

import numpy as np

from poise import Component, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Activity, Attention, Bearing

DIRECTIONS = 72
"""Directions that are told apart: every 5 degrees."""

MEMORY = 0.8
"""The share of the belief that is left after a cycle."""


class AttentionPlanner(Component):
    """Keeps a belief of who speaks where, and publishes the best direction to look."""

    attention: Published[Attention]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._angles = np.linspace(-math.pi, math.pi, DIRECTIONS, endpoint=False)
        self._belief = np.zeros(DIRECTIONS)
        self._activity = 0.0

    @subscribed(keep=4)
    def bearing(self, message: Bearing) -> None:
        off = np.angle(np.exp(1j * (self._angles - message.angle)))
        weight = message.strength * self._activity
        self._belief += weight * np.exp(-((off / 0.2) ** 2) / 2)

    @subscribed(keep=4)
    def activity(self, message: Activity) -> None:
        self._activity = message.probability

    @every(0.1)
    def plan(self) -> None:
        since = self._effort.start()
        best = int(self._belief.argmax())
        urgency = min(1.0, float(self._belief[best]))
        self._belief *= MEMORY
        self._effort.spend(self._turns, since)
        bearing = float(self._angles[best])
        self.attention.publish(Attention(self.clock.now(), bearing, urgency))

    def _turns(self, block: Block) -> int:
        """Return which of 225 sequences of head turns hears most."""
        gains = np.cumsum(block[:16200].reshape(225, DIRECTIONS), axis=1)
        return int((gains * (1 + self._belief)).sum(axis=1).argmax())
