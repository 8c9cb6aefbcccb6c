"""Finds the cup in the picture of the camera above the tray, with OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every
from trot.arm import arm_model, camera_model
from trot.device import Device
from trot.messages import Cup
from trot.packets import unpack_picture

LOW, HIGH = (100, 110, 60), (130, 255, 255)
"""Hue, saturation and brightness of what is blue, as the cup."""

SMALLEST = 0.5
"""The share of the rim that must be seen."""


class ObjectDetector(Component):
    """Publishes where the cup is, 20 times a second, while the arm hides it not."""

    cup: Published[Cup]

    def configure(self) -> None:
        self._cameras = Device(self.device("cameras"))

    @every(0.1, deadline=0.1)
    def look(self) -> None:
        for packet in self._cameras.receive()[-1:]:
            stamp, coded = unpack_picture(packet)
            pixels = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR)
            if found := find_cup(np.asarray(pixels)):
                self.cup.publish(Cup(stamp, *found))

    def cleanup(self) -> None:
        self._cameras.close()


def find_cup(pixels: NDArray[np.uint8]) -> tuple[float, float] | None:
    """Return x and y [m] of the cup in the robot's frame; None when it is not seen.

    Parameters
    ----------
    pixels
        ``(480, 640, 3)``, blue first.
    """
    smooth = cv2.medianBlur(pixels, 5)
    colours = cv2.cvtColor(smooth, cv2.COLOR_BGR2HSV)
    blue = np.asarray(cv2.inRange(colours, LOW, HIGH), np.uint8)
    rim_height = arm_model.TRAY_HEIGHT + arm_model.CUP_HEIGHT
    radius = camera_model.pixels_of(arm_model.CUP_RADIUS, rim_height)
    grey = cv2.GaussianBlur(blue, (7, 7), 0)
    circles = cv2.HoughCircles(
        grey,
        cv2.HOUGH_GRADIENT,
        dp=1,
        minDist=2 * radius,
        param1=100,
        param2=12,
        minRadius=round(0.85 * radius),
        maxRadius=round(1.15 * radius),
    )
    if circles is None:
        return None
    best, most = None, SMALLEST
    for column, row, size in np.asarray(circles).reshape(-1, 3):
        disc = np.zeros_like(blue)
        cv2.circle(disc, (round(column), round(row)), round(size), 255, -1)
        share = float(np.count_nonzero(blue & disc) / np.count_nonzero(disc))
        if share > most:
            best, most = (float(column), float(row)), share
    return None if best is None else camera_model.place(*best, rim_height)
