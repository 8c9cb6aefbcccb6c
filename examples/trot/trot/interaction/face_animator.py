"""Draws the robot's face with OpenCV: it speaks, blinks, and looks at who speaks."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every, subscribed
from trot.messages import Attention, Image, Mouth

HEIGHT, WIDTH = 240, 320
FINER = 2
"""Drawn so many times larger and then scaled down, for smooth edges."""

BLINK, CLOSED = 4.0, 0.15
"""[s] from blink to blink, and how long one takes."""

QUIET = 0.2
"""[s] without a sound after which the mouth is closed."""

SKIN, EYES, LIPS = (190, 222, 245), (90, 60, 40), (60, 60, 170)


class FaceAnimator(Component):
    """Publishes 20 frames a second."""

    face: Published[Image]

    def configure(self) -> None:
        self._mouth = Mouth(-math.inf, 0.0)
        self._gaze = 0.0

    @subscribed(keep=1)
    def mouth(self, message: Mouth) -> None:
        self._mouth = message

    @subscribed(keep=1)
    def attention(self, message: Attention) -> None:
        self._gaze = message.bearing

    @every(0.05, deadline=0.05)
    def animate(self) -> None:
        now = self.clock.now()
        opened = self._mouth.loudness if now - self._mouth.stamp < QUIET else 0.0
        pixels = face(self._gaze, opened, closed=now % BLINK < CLOSED)
        self.face.publish(Image(now, pixels))


def face(gaze: float, opened: float, *, closed: bool) -> NDArray[np.uint8]:
    """Return a face ``(HEIGHT, WIDTH, 3)``, blue first.

    Parameters
    ----------
    gaze
        Where it looks [rad], counter-clockwise from ahead.
    opened
        How wide the mouth is open, 0 to 1.
    closed
        Whether the eyes are.
    """
    pixels = np.full((FINER * HEIGHT, FINER * WIDTH, 3), SKIN, np.uint8)
    # Seen from outside, the robot's left is to the right.
    aside = round(14 * math.sin(max(-1.5, min(1.5, gaze))))
    for middle in (WIDTH // 2 - 65, WIDTH // 2 + 65):
        _ellipse(pixels, (middle, 90), (34, 4 if closed else 26), (255, 255, 255))
        if not closed:
            _ellipse(pixels, (middle + aside, 90), (13, 13), EYES)
            _ellipse(pixels, (middle + aside + 4, 85), (4, 4), (255, 255, 255))
    _ellipse(pixels, (WIDTH // 2, 180), (50, 5 + round(22 * opened)), LIPS)
    small = cv2.resize(pixels, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def _ellipse(
    pixels: NDArray[np.uint8],
    middle: tuple[int, int],
    half: tuple[int, int],
    colour: tuple[int, int, int],
) -> None:
    x, y = middle
    centre, axes = (FINER * x, FINER * y), (FINER * half[0], FINER * half[1])
    cv2.ellipse(pixels, centre, axes, 0, 0, 360, colour, cv2.FILLED, cv2.LINE_AA)
