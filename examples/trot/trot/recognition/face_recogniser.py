"""Recognises who is in view: a mean face is looked for in all sizes, with OpenCV."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every
from trot import eye_model
from trot.device import Device
from trot.household import FACE, PEOPLE, portrait
from trot.messages import Seen
from trot.packets import unpack_view

SIDE = 16
"""[pixels] Pictures are made smaller until a face has this size."""

SMALLEST, LARGEST, FINER = 20, 110, 1.15
"""[pixels] Faces are looked for in these sizes; they grow by this factor."""

FACE_LIKE, ALIKE = 0.5, 0.6
"""The normalised correlation from which on something is a face, and somebody's."""

Grey = NDArray[np.uint8]


class Face(NamedTuple):
    """Who is seen, in which column, and how large [pixels]."""

    name: str
    column: float
    size: float


class FaceRecogniser(Component):
    """Publishes who is in view, and where, after each picture with a known face.

    The parameter `smallest` [pixels] is the smallest face that is looked for: 20 is
    one at 3.9 m. Twice as large, and only half as far, takes a quarter of the time.
    """

    seen: Published[Seen]

    def configure(self) -> None:
        self._eyes = Device(self.device("eyes"))
        self._finder = Finder(float(self.parameters.get("smallest", SMALLEST)))

    @every(eye_model.PERIOD, deadline=eye_model.PERIOD)
    def look(self) -> None:
        for packet in self._eyes.receive()[-1:]:
            stamp, head, coded = unpack_view(packet)
            grey = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE)
            if face := self._finder.find(np.asarray(grey)):
                bearing = head + eye_model.angle(face.column)
                distance = FACE * eye_model.FOCAL / face.size
                self.seen.publish(Seen(stamp, face.name, bearing, distance))

    def cleanup(self) -> None:
        self._eyes.close()


class Finder:
    """Finds what is most like a face, and then whose it is."""

    def __init__(self, smallest: float = SMALLEST) -> None:
        self._portraits = {name: _small(portrait(name)) for name in PEOPLE}
        faces = [each.astype(float) for each in self._portraits.values()]
        self._mean = np.mean(faces, axis=0).astype(np.uint8)
        steps = int(np.log(LARGEST / smallest) / np.log(FINER)) + 1
        self._sizes = smallest * FINER ** np.arange(steps)

    def find(self, picture: Grey) -> Face | None:
        """Return it; None when nothing is like a face, or like nobody's."""
        found, most = None, FACE_LIKE
        for size in self._sizes:
            share = SIDE / size
            small = cv2.resize(
                picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA
            )
            likeness = cv2.matchTemplate(small, self._mean, cv2.TM_CCOEFF_NORMED)
            _, top, _, (left, above) = cv2.minMaxLoc(likeness)
            if top > most:
                grey = np.asarray(small, np.uint8)
                found, most = (grey, left, above, float(size)), top
        return None if found is None else self._whose(*found)

    def _whose(self, small: Grey, left: int, above: int, size: float) -> Face | None:
        """Return whose face it is: compared with each portrait, a pixel to and fro."""
        rows = slice(max(0, above - 1), above + SIDE + 1)
        part = small[rows, max(0, left - 1) : left + SIDE + 1]
        likeness = {
            name: float(cv2.matchTemplate(part, face, cv2.TM_CCOEFF_NORMED).max())
            for name, face in self._portraits.items()
        }
        name = max(likeness, key=likeness.__getitem__)
        column = (left + SIDE / 2) * size / SIDE
        return Face(name, column, size) if likeness[name] > ALIKE else None


def _small(pixels: NDArray[np.uint8]) -> Grey:
    grey = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA))
