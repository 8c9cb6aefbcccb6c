"""What the microphones hear: somebody who talks, now and then, from one side."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trot.packets import MICROPHONES, SAMPLE_RATE, SOUND_SAMPLES

SPACING = 0.1
"""[m] from microphone to microphone, in a row."""

SPEED_OF_SOUND = 343.0
"""[m/s]"""

BEARING = 0.5
"""[rad] The speaker's direction, from straight ahead towards the last microphone."""

_LOOP = 40
"""Blocks until the sound begins again: 2 s, the first half of them with speech."""


def delay(bearing: float) -> float:
    """Return how much later [s] each microphone hears than the one before it."""
    return SPACING * math.sin(bearing) / SPEED_OF_SOUND


class Sound:
    """An endless loop of blocks ``(MICROPHONES, SOUND_SAMPLES)``."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        length = _LOOP * SOUND_SAMPLES
        voice = random.normal(0, 3000, length) * (np.arange(length) < length / 2)
        self._samples = np.stack(
            [
                np.roll(voice, round(microphone * delay(BEARING) * SAMPLE_RATE))
                + random.normal(0, 100, length)
                for microphone in range(MICROPHONES)
            ]
        ).astype(np.int16)
        self._next = 0

    def block(self) -> NDArray[np.int16]:
        """Return the next block."""
        start = self._next * SOUND_SAMPLES
        self._next = (self._next + 1) % _LOOP
        return self._samples[:, start : start + SOUND_SAMPLES]
