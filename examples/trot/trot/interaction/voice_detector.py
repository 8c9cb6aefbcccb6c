"""Cuts what the microphones hear into sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pocketsphinx import Endpointer

from poise import Component, Published, subscribed
from trot.messages import AudioBlock, Speech
from trot.packets import SAMPLE_RATE

FRAME = 0.03
"""[s] of sound that is judged at once."""

WINDOW = 0.3
"""[s] A sentence begins and ends when so much of a window is speech, or is not."""


class VoiceDetector(Component):
    """Publishes the sound of sentences while they last, and says when they end."""

    speech: Published[Speech]

    def configure(self) -> None:
        self._endpointer = Endpointer(
            window=WINDOW,
            ratio=0.8,
            vad_mode=3,
            sample_rate=SAMPLE_RATE,
            frame_length=FRAME,
        )
        self._frame = self._endpointer.frame_bytes // 2
        self._rest: NDArray[np.int16] = np.zeros(0, np.int16)

    @subscribed(keep=8)
    def audio(self, message: AudioBlock) -> None:
        mixed = message.samples.mean(axis=0).astype(np.int16)
        sound = np.concatenate([self._rest, mixed])
        whole = len(sound) - len(sound) % self._frame
        self._rest = sound[whole:]
        spoken, ends = bytearray(), False
        for frame in sound[:whole].reshape(-1, self._frame):
            was_speech = self._endpointer.in_speech
            spoken += self._endpointer.process(frame.tobytes()) or b""
            # pocketsphinx says 0 and 1, which are no bool for a message
            ends = ends or bool(was_speech and not self._endpointer.in_speech)
        if spoken or ends:
            samples = np.frombuffer(bytes(spoken), np.int16)
            self.speech.publish(Speech(message.stamp, samples, ends=ends))
