"""Recognises what somebody says, with pocketsphinx and the English model in it.

One pass knows the household's commands by their grammar (`commands.gram`). Another one
has a general language model, and writes along what is said: captions for people who
hear badly. Without the second (``captions: false``) recognition is ten times cheaper.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pocketsphinx import Decoder

from poise import Component, Published, subscribed
from trot.messages import Caption, Speech, Utterance

CAPTIONS: dict[str, Any] = {
    "ds": 2,
    "maxhmmpf": 1500,
    "maxwpf": 8,
    "fwdflat": False,
    "bestpath": False,
    "loglevel": "FATAL",
}
"""Each second frame, few words at once, one pass: a third of the time for captions."""

GRAMMAR = Path(__file__).with_name("commands.gram")


class SpeechRecogniser(Component):
    """Publishes captions while somebody speaks, and commands when they end."""

    utterance: Published[Utterance]
    caption: Published[Caption]

    def configure(self) -> None:
        self._commands = Decoder(lm=None, jsgf=str(GRAMMAR), loglevel="FATAL")
        self._passes = [self._commands]
        if self.parameters.get("captions", True):
            self._words = Decoder(**CAPTIONS)
            self._passes.append(self._words)
        self._hears = False

    @subscribed(keep=16)
    def speech(self, message: Speech) -> None:
        if not self._hears:
            self._hears = True
            for each in self._passes:
                each.start_utt()
        if len(message.samples):
            for each in self._passes:
                each.process_raw(message.samples.tobytes())
        if message.ends:
            self._end(message.stamp)
        elif len(self._passes) > 1:
            self.caption.publish(Caption(message.stamp, text(self._words)))

    def _end(self, stamp: float) -> None:
        self._hears = False
        # Somebody waits for an answer: the captions are ended after it.
        self._commands.end_utt()
        if command := text(self._commands):
            self.utterance.publish(Utterance(stamp, command))
        for each in self._passes[1:]:
            each.end_utt()


def text(decoder: Decoder) -> str:
    """Return what a decoder has understood so far."""
    best = decoder.hyp()
    return best.hypstr if best else ""
