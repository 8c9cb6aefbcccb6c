"""The picture of the camera in the head, drawn from the world's state by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from trot import eye_model
from trot.household import FACE, WALL, portrait

NOISE = 6
"""Standard deviation of a pixel's colours."""

QUALITY = 80
NEAREST = 0.5
"""[m] A face is drawn no larger than from here."""


class Eye:
    """Takes pictures of one person as JPEG.

    Parameters
    ----------
    name
        Of whom, in `trot.household`.
    """

    def __init__(self, name: str, seed: int = 0) -> None:
        self._face = portrait(name)
        self._random = np.random.default_rng(seed)
        shape = (eye_model.ROWS, eye_model.COLUMNS, 3)
        self._noise = [
            self._random.normal(0, NOISE, shape).astype(np.int16) for _ in range(4)
        ]

    def picture(self, angle: float, distance: float | None) -> NDArray[np.uint8]:
        """Return what the camera sees, ``(240, 320, 3)``, blue first.

        Parameters
        ----------
        angle
            Where the person is [rad], counter-clockwise from where the camera looks.
        distance
            How far [m]; None: nobody is in view.
        """
        pixels = np.full((eye_model.ROWS, eye_model.COLUMNS, 3), WALL, np.uint8)
        cv2.rectangle(pixels, (0, 170), (eye_model.COLUMNS, 240), (90, 110, 125), -1)
        if distance is not None:
            self._draw(pixels, angle, max(NEAREST, distance))
        noise = self._noise[int(self._random.integers(4))]
        return np.asarray(cv2.add(pixels, noise, dtype=cv2.CV_8U))

    def jpeg(self, angle: float, distance: float | None) -> bytes:
        """Return the picture as JPEG."""
        picture = self.picture(angle, distance)
        _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return bytes(coded)

    def _draw(self, pixels: NDArray[np.uint8], angle: float, distance: float) -> None:
        """Put the face into the picture, as much of it as is in view."""
        size = max(4, round(eye_model.pixels_of(FACE, distance)))
        face = cv2.resize(self._face, (size, size), interpolation=cv2.INTER_AREA)
        left = round(eye_model.column(angle) - size / 2)
        top = round(eye_model.ROWS / 2 - size / 2)
        first, last = max(0, left), min(eye_model.COLUMNS, left + size)
        if first < last:
            seen = face[:, first - left : last - left]
            pixels[top : top + size, first:last] = seen
