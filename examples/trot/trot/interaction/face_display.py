"""Puts face and recommendations together on the robot's screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Image


class FaceDisplay(Component):
    """Composes ten screens a second: the face, and the panel in a corner of it."""

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._face: Image | None = None
        self._panel: Image | None = None

    @subscribed(keep=1)
    def face(self, message: Image) -> None:
        self._face = message

    @subscribed(keep=1)
    def panel(self, message: Image) -> None:
        self._panel = message

    @every(0.1)
    def show(self) -> None:
        since = self._effort.start()
        if self._face is not None:
            screen = compose(self._face, self._panel)
            self.measure("brightness", float(screen.mean()))
        self._effort.spend(_gamma, since)


def compose(face: Image, panel: Image | None) -> NDArray[np.uint8]:
    """Return the face at twice its size, with the panel in the lower right corner."""
    screen = face.pixels.repeat(2, axis=0).repeat(2, axis=1)
    if panel is not None:
        height, width, _ = panel.pixels.shape
        screen[-height // 2 :, -width // 2 :] = panel.pixels[::2, ::2]
    return screen


def _gamma(block: Block) -> Block:
    """Return a part of the screen, corrected for what the eye sees."""
    return np.sqrt(block)
