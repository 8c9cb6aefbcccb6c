"""Tells speech from noise, and hands speech on as features."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Activity, AudioBlock, Speech

BANDS = 20
FRAMES = 20
"""Blocks that make one message of speech features: a second of sound."""

LOUD = 300.0
"""Root mean square of samples above which sound is speech, half and half."""


class SpeechDetector(Component):
    """Publishes the probability of speech per block, and features of what was said."""

    activity: Published[Activity]
    speech: Published[Speech]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._frames: deque[NDArray[np.float32]] = deque(maxlen=FRAMES)

    @subscribed(keep=2)
    def audio(self, message: AudioBlock) -> None:
        since = self._effort.start()
        energies = bands(message.samples[0])
        self._frames.append(np.log(energies + 1))
        loudness = float(np.sqrt(energies.mean()))
        probability = loudness**2 / (loudness**2 + LOUD**2)
        self._effort.spend(self._compare, since)
        self.activity.publish(Activity(message.stamp, probability))

    @every(0.5)
    def hand_on(self) -> None:
        if self._frames:
            features = np.stack(self._frames)
            self.speech.publish(Speech(self.clock.now(), features))

    def _compare(self, block: Block) -> int:
        """Return which of many stored voices a stretch of past sound is nearest to."""
        voices = block.reshape(-1, 32)
        return int(np.square(voices - voices[0]).sum(axis=1)[1:].argmin())


def bands(samples: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return the mean power in each of `BANDS` bands, ``(BANDS,)``."""
    power = np.square(np.abs(np.fft.rfft(samples.astype(float)))) / len(samples)
    parts = np.array_split(power, BANDS)
    return np.array([part.mean() for part in parts], np.float32)
