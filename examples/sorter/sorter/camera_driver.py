"""Takes the camera's pictures, and takes the colour of the lamps out of them."""

from __future__ import annotations

import cv2
import numpy as np

from poise import Component, Published, every
from sorter import cell
from sorter.device import Device
from sorter.lamps import lit
from sorter.messages import Picture

BELT = 60.0
"""How bright the grey belt, which fills most of a picture, is to be."""


class CameraDriver(Component):
    """Publishes each picture in colour, and every second one in grey."""

    picture: Published[Picture]
    view: Published[Picture]

    def configure(self) -> None:
        self._camera = Device(self.device("camera"))
        self._pictures = 0

    @every(cell.CAMERA_PERIOD, deadline=cell.CAMERA_PERIOD)
    def read(self) -> None:
        if (packet := self._camera.newest()) is None:
            return
        at, coded = packet
        picture = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR)
        pixels = np.asarray(picture, np.uint8)
        belt = np.median(pixels[::4, ::4].reshape(-1, 3), axis=0)
        pixels = lit(pixels, BELT / np.maximum(belt, 1.0))
        taken = self.clock.stamp(at)
        self.picture.publish(Picture(taken, pixels))
        self._pictures += 1
        if self._pictures % 2 == 0:
            grey = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
            self.view.publish(Picture(taken, np.asarray(grey, np.uint8)))

    def cleanup(self) -> None:
        self._camera.close()
