"""What the components say to each other, and what they call each other for."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from poise import Message, Stamp


class Picture(Message, frozen=True):
    """Pixels, ``(HEIGHT, WIDTH, 3)`` blue first, or ``(HEIGHT, WIDTH)`` grey."""

    taken: Stamp
    pixels: NDArray[np.uint8]


class Detections(Message, frozen=True):
    """Places x, y [m] of the objects in a picture, ``(n, 2)``, and their colours."""

    taken: Stamp
    places: NDArray[np.float32]
    colours: list[str]


class Tracks(Message, frozen=True):
    """Objects on the belt, seen or not, when a picture was taken; speed in [m/s]."""

    taken: Stamp
    speed: float
    numbers: list[int]
    places: NDArray[np.float32]
    colours: list[str]


class Defects(Message, frozen=True):
    """Places x, y [m] of scratched objects in a picture, ``(n, 2)``."""

    taken: Stamp
    places: NDArray[np.float32]


class Motion(Message, frozen=True):
    """Joint angles [rad] every `STEP` from a moment on, ``(n, 4)``."""

    begins: Stamp
    angles: NDArray[np.float32]


STEP = 0.03
"""[s] between the postures of a motion."""


class Grip(Message, frozen=True):
    """The hand is to close or to open, so long [s] after a moment."""

    begins: Stamp
    after: float
    closed: bool


class Guard(Message, frozen=True):
    """Whether nobody is near the arm."""

    seen: Stamp
    clear: bool


class Belt(Protocol):
    """Knows how the belt runs."""

    def travel(self, taken: Stamp, ahead: list[float]) -> list[float]:
        """Return how far the belt runs [m] from a moment until `ahead` [s] from now.

        Nothing, while its speed or the moment's clock is not known yet.
        """
        ...
