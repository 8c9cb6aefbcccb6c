"""Speaks, with the voice of eSpeak NG."""

from __future__ import annotations

import ctypes

import espeakng_loader
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every, subscribed
from trot.device import Device
from trot.messages import Mouth, Sentence
from trot.packets import SAMPLE_RATE, SOUND_PERIOD, SOUND_SAMPLES

_SYNCHRONOUS = 2
_UTF8 = 1
_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.c_void_p
)


class Voice:
    """eSpeak NG's library, of which a process has one."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL(espeakng_loader.get_library_path())
        folder = espeakng_loader.get_data_path().encode()
        self._rate = self._library.espeak_Initialize(_SYNCHRONOUS, 0, folder, 0)
        if self._rate <= 0:
            raise RuntimeError(f"eSpeak NG cannot read its data in {folder!r}")
        self._library.espeak_SetVoiceByName(b"en")
        self._got = bytearray()
        self._callback = _CALLBACK(self._take)  # kept, for the library does not
        self._library.espeak_SetSynthCallback(self._callback)

    def say(self, text: str) -> NDArray[np.int16]:
        """Return the samples of `text`, `SAMPLE_RATE` a second."""
        self._got.clear()
        words = text.encode() + b"\0"
        self._library.espeak_Synth(words, len(words), 0, 0, 0, _UTF8, None, None)
        samples = np.frombuffer(bytes(self._got), np.int16)
        moments = np.arange(0, len(samples), self._rate / SAMPLE_RATE)
        heard = np.interp(moments, np.arange(len(samples)), samples)
        return np.asarray(heard, np.int16)

    def _take(self, wave: object, samples: int, _: object) -> int:
        if samples > 0:
            self._got += ctypes.string_at(wave, 2 * samples)  # type: ignore[arg-type]
        return 0


class SpeechSynthesiser(Component):
    """Sends a sentence to the speakers, block by block, and moves the mouth to it."""

    mouth: Published[Mouth]

    def configure(self) -> None:
        self._speakers = Device(self.device("speakers"))
        self._voice = Voice()
        self._left: NDArray[np.int16] = np.zeros(0, np.int16)

    @subscribed(keep=4)
    def sentence(self, message: Sentence) -> None:
        self._left = np.concatenate([self._left, self._voice.say(message.text)])

    @every(SOUND_PERIOD)
    def speak(self) -> None:
        block, self._left = self._left[:SOUND_SAMPLES], self._left[SOUND_SAMPLES:]
        if len(block):
            self._speakers.send(block.tobytes())
            loud = float(np.sqrt(np.square(block, dtype=float).mean()))
            self.mouth.publish(Mouth(self.clock.now(), min(1.0, loud / 6000)))

    def cleanup(self) -> None:
        self._speakers.close()
