"""The picture of the camera above the tray, drawn from the world's state by OpenCV."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from trot.arm import arm_model, camera_model
from trot.arm.camera_model import pixel, pixels_of

TABLE, TRAY, COASTER = (120, 130, 140), (150, 190, 215), (110, 140, 170)
BOTTLE, CUP, INSIDE, ARM = (60, 120, 60), (190, 70, 30), (130, 50, 25), (70, 70, 75)
NOISE = 6
"""Standard deviation of a pixel's colours."""

QUALITY = 85

Point = NDArray[np.float64]


class Camera:
    """Takes pictures as JPEG."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        shape = (camera_model.ROWS, camera_model.COLUMNS, 3)
        # Of a few patterns one is taken at random: new noise for each is slow.
        self._noise = [
            random.normal(0, NOISE, shape).astype(np.int16) for _ in range(4)
        ]
        self._random = random
        self._scene = _scene()

    def picture(self, cup: Point, arm: list[Point]) -> NDArray[np.uint8]:
        """Return what the camera sees, ``(480, 640, 3)``, blue first.

        Parameters
        ----------
        cup
            The middle of the cup in the robot's frame [m].
        arm
            The arm's joints and the hand [m], from the shoulder on.
        """
        pixels = self._scene.copy()
        for height in np.linspace(-1, 1, 6) * arm_model.CUP_HEIGHT / 2:
            up = float(cup[2] + height)
            _disc(pixels, cup[0], cup[1], up, arm_model.CUP_RADIUS, CUP)
        _disc(pixels, cup[0], cup[1], up, arm_model.CUP_RADIUS - 0.005, INSIDE)
        for start, end in pairwise(arm):
            wide = round(pixels_of(0.044, float(start[2])))
            cv2.line(
                pixels, _at(pixel(*start)), _at(pixel(*end)), ARM, wide, cv2.LINE_AA
            )
        noise = self._noise[int(self._random.integers(4))]
        return np.asarray(cv2.add(pixels, noise, dtype=cv2.CV_8U))

    def jpeg(self, cup: Point, arm: list[Point]) -> bytes:
        """Return the picture as JPEG."""
        picture = self.picture(cup, arm)
        _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return bytes(coded)


def _scene() -> NDArray[np.uint8]:
    """Return what never changes: table, tray, coasters and bottle."""
    pixels = np.full((camera_model.ROWS, camera_model.COLUMNS, 3), TABLE, np.uint8)
    x, y = arm_model.TRAY
    half_x, half_y = arm_model.TRAY_HALF
    corners = [
        pixel(x - half_x, y + half_y, arm_model.TRAY_HEIGHT),
        pixel(x + half_x, y - half_y, arm_model.TRAY_HEIGHT),
    ]
    cv2.rectangle(pixels, _at(corners[0]), _at(corners[1]), TRAY, -1)
    for place in arm_model.PLACES.values():
        _disc(pixels, *place, arm_model.TRAY_HEIGHT, 0.045, COASTER)
    for height in np.linspace(0, arm_model.BOTTLE_HEIGHT, 8):
        up = arm_model.TRAY_HEIGHT + float(height)
        _disc(pixels, x, y, up, arm_model.BOTTLE_RADIUS, BOTTLE)
    return pixels


def _at(point: Point) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _disc(
    pixels: NDArray[np.uint8],
    x: float,
    y: float,
    height: float,
    radius: float,
    colour: tuple[int, int, int],
) -> None:
    size = round(pixels_of(radius, height))
    cv2.circle(pixels, _at(pixel(x, y, height)), size, colour, -1, cv2.LINE_AA)
