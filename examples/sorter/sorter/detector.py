"""Finds the objects in a picture, and their colours, with OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from sorter import cell
from sorter.messages import Detections, Picture

HUES = {"red": 0, "green": 60, "blue": 110}
"""OpenCV's hues go from 0 to 179, and red is at both ends."""

LEAST = 0.4
"""The share of an object's area that must be seen."""


class Detector(Component):
    """Publishes what is in each picture.

    The parameter `scale` makes pictures smaller first: 0.4 needs a fifth of the CPU,
    and sees places less exactly.
    """

    detections: Published[Detections]

    def configure(self) -> None:
        self._scale = float(self.parameters.get("scale", 1.0))

    @subscribed(keep=1)
    def picture(self, message: Picture) -> None:
        places, colours = find(message.pixels, self._scale)
        self.detections.publish(Detections(message.taken, places, colours))


def find(
    pixels: NDArray[np.uint8], scale: float = 1.0
) -> tuple[NDArray[np.float32], list[str]]:
    """Return the places [m] of the objects, ``(n, 2)``, and their colours."""
    if scale != 1.0:
        size = round(cell.WIDTH * scale), round(cell.HEIGHT * scale)
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    # It smooths the noise of the camera, and keeps the edges.
    smooth = cv2.bilateralFilter(pixels, 9, 40, 5)
    hue, saturation, _ = cv2.split(cv2.cvtColor(smooth, cv2.COLOR_BGR2HSV))
    mask = np.asarray(cv2.inRange(saturation, 100, 255), np.uint8)
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3))))
    least = LEAST * (2 * cell.OBJECT / cell.PIXEL * scale) ** 2
    places, colours = [], []
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for contour in contours:
        left, top, width, height = cv2.boundingRect(contour)
        is_whole = 0 < left < pixels.shape[1] - width
        if is_whole and cv2.contourArea(contour) >= least:
            middle = (left + (width - 1) / 2, top + (height - 1) / 2)
            places.append(cell.place(((middle[0] + 0.5) / scale, middle[1] / scale)))
            row, column = round(middle[1]), round(middle[0])
            around = hue[row - 2 : row + 3, column - 2 : column + 3]
            colours.append(_colour(float(np.median(around))))
    return np.array(places, np.float32).reshape(-1, 2), colours


def _colour(hue: float) -> str:
    def off(name: str) -> float:
        away = abs(hue - HUES[name])
        return min(away, 180 - away)

    return min(HUES, key=off)
