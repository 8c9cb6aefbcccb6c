"""The robot's mood."""

from __future__ import annotations

import numpy as np

from poise import Component, Message, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Emotion, Sentence

FADES = 0.95
"""The share of a mood that is left after a cycle."""


class Mood(Message, frozen=True):
    """What an emotion model hands to its successor."""

    valence: float
    arousal: float


class EmotionModel(Component):
    """Speaking pleases and wakes the robot; then the mood fades."""

    emotion: Published[Emotion]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._valence = self._arousal = 0.0

    @subscribed(keep=2)
    def sentence(self, message: Sentence) -> None:
        self._valence = 0.5 if "?" in message.text else 0.3
        self._arousal = min(1.0, self._arousal + 0.4)

    @every(0.1)
    def feel(self) -> None:
        self._effort.spend(_drift, self._effort.start())
        self._valence *= FADES
        self._arousal *= FADES
        self.emotion.publish(Emotion(self.clock.now(), self._valence, self._arousal))

    def snapshot(self) -> Mood:
        return Mood(self._valence, self._arousal)

    def restore(self, state: Mood) -> None:
        self._valence, self._arousal = state.valence, state.arousal


def _drift(block: Block) -> float:
    """Return the mean of many moods after a step of a network."""
    return float(np.tanh(block[:8192] - 0.5).mean())
