"""Reads the microphones."""

from __future__ import annotations

import numpy as np

from poise import Component, Published, every
from trot.device import Device
from trot.effort import Block, Effort
from trot.messages import AudioBlock
from trot.packets import SOUND_PERIOD, unpack_sound


class MicrophoneArray(Component):
    """Publishes each block of sound without its offset, and knows the noise floor."""

    audio: Published[AudioBlock]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._microphones = Device(self.device("microphones"))
        self._floor = 0.0

    @every(SOUND_PERIOD)
    def read(self) -> None:
        since = self._effort.start()
        for packet in self._microphones.receive():
            stamp, samples = unpack_sound(packet)
            offset = samples.mean(axis=1, keepdims=True).astype(np.int16)
            self.audio.publish(AudioBlock(stamp, samples - offset))
        self._effort.spend(self._listen, since)

    def cleanup(self) -> None:
        self._microphones.close()

    def _listen(self, block: Block) -> None:
        """Take the quietest tenth of a stretch of past sound as the noise floor."""
        energy = np.square(block.reshape(-1, 64)).mean(axis=1)
        self._floor = float(np.partition(energy, 25)[25])
