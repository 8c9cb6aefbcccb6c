"""Draws the robot's face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Emotion, Image

HEIGHT, WIDTH = 120, 160


class FaceAnimator(Component):
    """Publishes ten frames a second: eyes as wide as it is awake, mouth by mood."""

    face: Published[Image]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._emotion = Emotion(0.0, 0.0, 0.0)

    @subscribed(keep=1)
    def emotion(self, message: Emotion) -> None:
        self._emotion = message

    @every(0.1)
    def animate(self) -> None:
        since = self._effort.start()
        pixels = face(self._emotion.valence, self._emotion.arousal)
        self._effort.spend(_shade, since)
        self.face.publish(Image(self.clock.now(), pixels))


def face(valence: float, arousal: float) -> NDArray[np.uint8]:
    """Return a face ``(HEIGHT, WIDTH, 3)``; both parameters in [-1, 1]."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    wide = 8 + 6 * arousal
    eyes = np.hypot(np.abs(x - 80) - 35, (y - 45) * 10 / wide) < 10
    smile = 90 - valence * 15 * ((x - 80) / 35.0) ** 2
    mouth = (np.abs(y - smile) < 3) & (np.abs(x - 80) < 35)
    pixels = np.full((HEIGHT, WIDTH, 3), (245, 222, 190), np.uint8)
    pixels[eyes] = (40, 60, 90)
    pixels[mouth] = (170, 60, 60)
    return pixels


def _shade(block: Block) -> Block:
    """Return a part of the skin, lit from one side."""
    skin = block.reshape(128, 128)
    light = np.clip(np.diff(skin, axis=0) + 0.5, 0, 1)
    return np.asarray(light * skin[1:])
