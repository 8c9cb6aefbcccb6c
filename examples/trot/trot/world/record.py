"""Records what people say in T-Rot's home, with the voices of flite.

``python -m trot.world.record`` needs the program ``flite`` (a package of Debian), and
writes ``sentences.npz`` beside this file. That is kept, so nobody else needs flite.
"""

from __future__ import annotations

import subprocess
import tempfile
import wave
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trot.packets import SAMPLE_RATE

FILE = Path(__file__).with_name("sentences.npz")
VOICES = ("slt", "rms")
SENTENCES = (
    "put the cup on the left",
    "put the cup on the right",
    "what is on television",
    "where are my glasses",
    "where is the remote control",
    "what is the time",
    "how warm is it outside",
    "when does the doctor come",
    "good morning robot",
    "thank you robot",
)


def recorded() -> list[tuple[str, NDArray[np.int16]]]:
    """Return what people say, and its samples; one voice after the other."""
    with np.load(FILE) as kept:
        return [(name.split("/")[1], kept[name]) for name in sorted(kept)]


def _said(sentence: str, voice: str) -> NDArray[np.int16]:
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        command = ["flite", "-voice", voice, "-t", sentence, "-o", file.name]
        subprocess.run(command, check=True)  # noqa: S603 - our own words
        with wave.open(file.name) as sound:
            if sound.getframerate() != SAMPLE_RATE:
                raise ValueError(
                    f"voice '{voice}' has {sound.getframerate()} samples/s"
                )
            return np.frombuffer(sound.readframes(sound.getnframes()), np.int16)


if __name__ == "__main__":
    pairs = [(voice, each) for voice in VOICES for each in SENTENCES]
    sounds: dict[str, Any] = {f"{v}/{s}": _said(s, v) for v, s in pairs}
    np.savez_compressed(FILE, **sounds)
