"""Finds where a sound comes from: the steered response power of four microphones.

SRP-PHAT (DiBiase, 2000) looks in steps of 2 degrees around the robot. pyroomacoustics
has it, too, but takes longer to import than the robot needs to start.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from trot.array import MICROPHONES_AT
from trot.messages import AudioBlock, Bearing
from trot.packets import SAMPLE_RATE

BLOCKS = 5
"""Blocks of sound that are looked at together: a quarter of a second."""

CLEAR = 1.2
"""So much stronger than the mean is a sound's own direction; noise reaches 1.1."""

SPEED_OF_SOUND = 343.0
"""[m/s]"""

DIRECTIONS = 180
FRAME = 512
BAND = (300, 3500)
"""[Hz] Here voices are."""


class SoundLocaliser(Component):
    """Looks 20 times a second, and publishes where a clear sound is from."""

    bearing: Published[Bearing]

    def configure(self) -> None:
        self._blocks: deque[NDArray[np.int16]] = deque(maxlen=BLOCKS)
        self._search = Search()

    @subscribed(keep=4)
    def audio(self, message: AudioBlock) -> None:
        self._blocks.append(message.samples)
        if len(self._blocks) < BLOCKS:
            return
        sound = np.concatenate(self._blocks, axis=1).astype(float)
        angle, clearness = self._search.look(sound)
        if clearness > CLEAR:
            self.bearing.publish(Bearing(message.stamp, angle))


class Search:
    """Looks in every direction for the strongest sound."""

    def __init__(self) -> None:
        frequencies = np.fft.rfftfreq(FRAME, 1 / SAMPLE_RATE)
        self._band = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
        angles = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
        towards = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        early = towards @ MICROPHONES_AT / SPEED_OF_SOUND
        turns = 2j * np.pi * frequencies[self._band, None, None] * early
        self._steer = np.exp(-turns).astype(np.complex64)
        """By frequency, direction and microphone."""
        self._angles = angles

    def look(self, sound: NDArray[np.float64]) -> tuple[float, float]:
        """Return where `sound` ``(MICROPHONES, n)`` is from [rad], 0 is ahead.

        And how much stronger it is from there than from anywhere.
        """
        frames = sliding_window_view(sound, FRAME, axis=1)[:, :: FRAME // 2]
        spectra = np.fft.rfft(frames * np.hanning(FRAME), axis=2)[:, :, self._band]
        phases = (spectra / (np.abs(spectra) + 1e-9)).astype(np.complex64)
        # All microphones, as late as each would hear a direction first, are added up.
        summed = self._steer @ phases.transpose(2, 0, 1)
        power = np.square(np.abs(summed)).sum(axis=(0, 2))
        best = int(power.argmax())
        return float(self._angles[best]), float(power[best] / power.mean())
