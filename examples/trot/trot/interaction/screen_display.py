"""Puts face, recommendations and text together, and sends them to the screen."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, subscribed
from trot.device import Device
from trot.messages import Caption, Image, Seen, Sentence
from trot.packets import Screen, pack_screen

HEIGHT, WIDTH = 480, 640
QUALITY = 80
"""Of the JPEG picture, of 100."""

FORGETS = 1.0
"""[s] Who was not seen for so long is not named."""


class ScreenDisplay(Component):
    """Shows a picture for each face: the panel in a corner of it, text below."""

    def configure(self) -> None:
        self._screen = Device(self.device("screen"))
        self._panel: Image | None = None
        self._caption = ""
        self._sentence = Sentence(0.0, "", "")
        self._seen, self._seen_at = "", 0.0

    @subscribed(keep=1)
    def panel(self, message: Image) -> None:
        self._panel = message

    @subscribed(keep=1)
    def caption(self, message: Caption) -> None:
        self._caption = message.text

    @subscribed(keep=1)
    def seen(self, message: Seen) -> None:
        self._seen, self._seen_at = message.name, self.clock.now()

    @subscribed(keep=2)
    def sentence(self, message: Sentence) -> None:
        self._sentence, self._caption = message, ""

    @subscribed(keep=1)
    def face(self, message: Image) -> None:
        said = self._sentence
        seen = self._seen if self.clock.now() - self._seen_at < FORGETS else ""
        lines = seen, self._caption or said.heard, said.text
        pixels = compose(message, self._panel, lines)
        coded, picture = cv2.imencode(
            ".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        )
        if coded:
            self._screen.send(
                pack_screen(
                    Screen(said.stamp, said.heard, said.text, seen, picture.tobytes())
                )
            )

    def cleanup(self) -> None:
        self._screen.close()


def compose(
    face: Image, panel: Image | None, lines: tuple[str, ...]
) -> NDArray[np.uint8]:
    """Return the face over the whole screen, with panel and text on it."""
    pixels = cv2.resize(face.pixels, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    if panel is not None:
        height, width, _ = panel.pixels.shape
        pixels[:height, -width:] = panel.pixels
    for number, line in enumerate(lines):
        place = (20, HEIGHT - 90 + 35 * number)
        cv2.putText(
            pixels, line, place, cv2.FONT_HERSHEY_SIMPLEX, 0.8, (40, 40, 40), 2, 16
        )
    return np.asarray(pixels, np.uint8)
