"""Speaks."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from poise import Component, every, subscribed
from trot.device import Device
from trot.effort import Block, Effort
from trot.messages import Sentence
from trot.packets import SAMPLE_RATE, SOUND_PERIOD, SOUND_SAMPLES

VOWELS = {"a": 730.0, "e": 530.0, "i": 270.0, "o": 570.0, "u": 300.0}
"""The first formant of each vowel [Hz]."""

PITCH = 140.0
"""[Hz]"""


class SpeechSynthesiser(Component):
    """Sends a block of sound to the speakers for each letter that is to be said."""

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._speakers = Device(self.device("speakers"))
        self._letters: deque[str] = deque(maxlen=500)

    @subscribed(keep=4)
    def sentence(self, message: Sentence) -> None:
        self._letters.extend(message.text.lower())

    @every(SOUND_PERIOD)
    def speak(self) -> None:
        since = self._effort.start()
        letter = self._letters.popleft() if self._letters else " "
        samples = sound(letter)
        self._effort.spend(_filter, since)
        self._speakers.send(samples.tobytes())

    def cleanup(self) -> None:
        self._speakers.close()


def sound(letter: str) -> NDArray[np.int16]:
    """Return how a letter sounds, ``(SOUND_SAMPLES,)``; what is no vowel is silent."""
    if letter not in VOWELS:
        return np.zeros(SOUND_SAMPLES, np.int16)
    time = np.arange(SOUND_SAMPLES) / SAMPLE_RATE
    voice = np.sin(2 * math.pi * PITCH * time)
    formant = np.sin(2 * math.pi * VOWELS[letter] * time)
    return (6000 * (voice + formant) * np.hanning(SOUND_SAMPLES)).astype(np.int16)


def _filter(block: Block) -> Block:
    """Return a stretch of a stored voice, filtered by the shape of the mouth."""
    taps = np.hanning(16).astype(np.float32)
    return np.convolve(block[:8192], taps, mode="same")
