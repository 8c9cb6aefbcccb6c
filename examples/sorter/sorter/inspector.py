"""Finds scratches on the objects with a bank of Gabor filters."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from sorter import cell
from sorter.messages import Defects, Picture

SIZE, SIGMA, WAVE = 13, 2.0, 7.0
"""Of the filters [pixels]."""

SCRATCHED = 25
"""Pixels inside an object that look like a dark line, at least."""

LIMIT = 35.0
"""How dark a line is, at least."""


class Inspector(Component):
    """Publishes which objects in the view are scratched.

    The parameter `directions` says in how many directions it looks for lines: with few
    it overlooks some.
    """

    defects: Published[Defects]

    def configure(self) -> None:
        self._bank = bank(int(self.parameters.get("directions", 8)))

    @subscribed(keep=1)
    def view(self, message: Picture) -> None:
        self.defects.publish(
            Defects(message.taken, scratched(message.pixels, self._bank))
        )


def bank(directions: int) -> list[NDArray[np.float32]]:
    """Return a filter for each direction, which answers to dark lines."""
    filters = []
    for angle in np.arange(directions) * np.pi / directions:
        line = cv2.getGaborKernel((SIZE, SIZE), SIGMA, angle, WAVE, 0.3, 0)
        line -= line.mean()
        filters.append(np.asarray(-line / np.abs(line).sum() * 2, np.float32))
    return filters


def scratched(
    view: NDArray[np.uint8], filters: list[NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Return the places [m] of the scratched objects, ``(n, 2)``."""
    smooth = cv2.GaussianBlur(view, (3, 3), 0)
    bright = np.asarray(cv2.inRange(smooth, 85, 255), np.uint8)
    whole = cv2.morphologyEx(bright, cv2.MORPH_CLOSE, np.ones((9, 9)))
    inside = np.asarray(cv2.erode(whole, np.ones((11, 11))), np.uint8)
    answers = np.full(view.shape, -np.inf, np.float32)
    for each in filters:
        answers = np.maximum(answers, cv2.filter2D(smooth, cv2.CV_32F, each))
    lines = (answers > LIMIT) & (inside > 0)
    count, labels, _, middles = cv2.connectedComponentsWithStats(inside)
    found = [
        cell.place(middles[label])
        for label in range(1, count)
        if np.count_nonzero(lines & (labels == label)) >= SCRATCHED
    ]
    return np.array(found, np.float32).reshape(-1, 2)
