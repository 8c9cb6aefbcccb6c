"""A component that asks another one for a megabyte, again and again."""

import time
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from poise import Component, Provided, Required, every

SIZE = 1_000_000
"""Of what is asked for [bytes]."""


class Images(Protocol):
    def image(self) -> NDArray[np.uint8]: ...


class Camera(Component):
    """Has an image."""

    images: Provided[Images]

    def configure(self) -> None:
        self.pixels = np.ones(SIZE, np.uint8)

    def image(self) -> NDArray[np.uint8]:
        return self.pixels


class Viewer(Component):
    """Asks for images."""

    images: Required[Images]

    @every(0.1)
    def look(self) -> None:
        began = time.monotonic()
        self.images.image()
        self.measure("trip", time.monotonic() - began)
