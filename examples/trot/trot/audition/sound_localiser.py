"""Finds where a sound comes from: by how much later each microphone hears it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from trot.effort import Block, Effort
from trot.messages import AudioBlock, Bearing
from trot.packets import SAMPLE_RATE
from trot.world.sound import SPACING, SPEED_OF_SOUND

UPSAMPLING = 8
"""Delays are found to an eighth of a sample."""


class SoundLocaliser(Component):
    """GCC-PHAT between the two outermost microphones, for every block."""

    bearing: Published[Bearing]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)

    @subscribed(keep=2)
    def audio(self, message: AudioBlock) -> None:
        since = self._effort.start()
        pairs = len(message.samples) - 1
        delay, strength = lag(message.samples[0], message.samples[-1])
        sine = delay / pairs * SPEED_OF_SOUND / SPACING
        angle = math.asin(max(-1.0, min(1.0, sine)))
        self._effort.spend(self._echoes, since)
        self.bearing.publish(Bearing(message.stamp, angle, strength))

    def _echoes(self, block: Block) -> float:
        """Return how strong the echoes are in a stretch of past sound."""
        spectrum = np.fft.rfft(block.reshape(8, -1), axis=1)
        echo = np.fft.irfft(np.log(np.abs(spectrum) + 1e-3), axis=1)
        return float(np.abs(echo[:, 16:]).max())


def lag(
    first: NDArray[np.int16], last: NDArray[np.int16], most: float = 1e-3
) -> tuple[float, float]:
    """Return how much later [s] `last` hears than `first`, and how sure that is.

    Parameters
    ----------
    first, last
        Samples of two microphones, ``(n,)``.
    most
        The longest delay that can be [s].
    """
    length = 2 * len(first)
    cross = np.fft.rfft(last.astype(float), length) * np.conj(
        np.fft.rfft(first.astype(float), length)
    )
    phase = cross / np.maximum(np.abs(cross), 1e-9)
    correlation = np.fft.irfft(phase, UPSAMPLING * length) * UPSAMPLING
    reach = round(most * SAMPLE_RATE * UPSAMPLING)
    near = np.concatenate([correlation[-reach:], correlation[: reach + 1]])
    best = int(near.argmax())
    strength = float(np.clip(near[best], 0, 1))
    return (best - reach) / (SAMPLE_RATE * UPSAMPLING), strength
