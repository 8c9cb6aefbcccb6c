"""Reads the microphones."""

from __future__ import annotations

import numpy as np

from poise import Component, Published, every
from trot.device import Device
from trot.messages import AudioBlock
from trot.packets import SOUND_PERIOD, unpack_sound


class MicrophoneArray(Component):
    """Publishes each block of sound without its offset."""

    audio: Published[AudioBlock]

    def configure(self) -> None:
        self._microphones = Device(self.device("microphones"))

    @every(SOUND_PERIOD)
    def read(self) -> None:
        for packet in self._microphones.receive():
            stamp, samples = unpack_sound(packet)
            offset = samples.mean(axis=1, keepdims=True).astype(np.int16)
            self.audio.publish(AudioBlock(stamp, samples - offset))

    def cleanup(self) -> None:
        self._microphones.close()
