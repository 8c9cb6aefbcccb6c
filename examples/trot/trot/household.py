"""The people who live in the home, and what their faces look like: drawn portraits."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""Blue, green, red."""


class Look(NamedTuple):
    """What tells a face from others."""

    skin: Colour
    hair: Colour
    long: bool = False
    beard: bool = False
    glasses: bool = False


PEOPLE = {
    "Anna": Look((160, 190, 230), (40, 90, 160), long=True),
    "Ben": Look((120, 150, 190), (30, 30, 40), beard=True),
    "Clara": Look((170, 195, 235), (90, 95, 100), glasses=True),
}

FACE = 0.28
"""[m] The side of what a portrait shows."""

WALL = (150, 150, 140)
"""The colour behind people."""

_SIZE = 160


def portrait(name: str) -> NDArray[np.uint8]:
    """Return the face of one of the `PEOPLE`, ``(160, 160, 3)``, blue first."""
    look = PEOPLE[name]
    pixels = np.full((_SIZE, _SIZE, 3), WALL, np.uint8)
    dark = _shade(look.skin, 0.7)
    if look.long:
        _ellipse(pixels, 80, 90, 64, 76, look.hair)
    _ellipse(pixels, 80, 70, 58, 62, look.hair)
    _ellipse(pixels, 80, 88, 50, 64, look.skin)
    for x in (60, 100):
        _ellipse(pixels, x, 76, 17, 12, dark)
        _ellipse(pixels, x, 78, 10, 5, (235, 235, 235))
        _ellipse(pixels, x, 78, 5, 5, (30, 30, 30))
        _ellipse(pixels, x, 64, 15, 3, look.hair)
        if look.glasses:
            cv2.circle(pixels, (x, 78), 18, (20, 20, 20), 4, cv2.LINE_AA)
    _ellipse(pixels, 80, 95, 7, 18, _shade(look.skin, 1.1))
    if look.beard:
        _ellipse(pixels, 80, 136, 36, 24, look.hair)
    _ellipse(pixels, 80, 126, 22, 6, (70, 70, 150))
    return pixels


def _shade(colour: Colour, share: float) -> Colour:
    blue, green, red = (min(255, round(share * each)) for each in colour)
    return blue, green, red


def _ellipse(
    pixels: NDArray[np.uint8], x: int, y: int, wide: int, high: int, colour: Colour
) -> None:
    centre, axes = (x, y), (wide, high)
    cv2.ellipse(pixels, centre, axes, 0, 0, 360, colour, cv2.FILLED, cv2.LINE_AA)
