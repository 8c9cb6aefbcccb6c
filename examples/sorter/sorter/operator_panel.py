"""Shows the operator the belt, what the robot knows of it, and whether it may move."""

from __future__ import annotations

import cv2

from poise import Component, subscribed
from sorter import cell
from sorter.device import Device
from sorter.messages import Guard, Picture, Tracks

LARGER, YELLOW = 2, (0, 220, 220)
QUALITY = 70
"""Of the JPEG, of 100."""


class OperatorPanel(Component):
    """Sends a JPEG of the scene to the screen for every view."""

    def configure(self) -> None:
        self._screen = Device(self.device("screen"))
        self._tracks: Tracks | None = None
        self._clear = False

    @subscribed(keep=1)
    def tracks(self, message: Tracks) -> None:
        self._tracks = message

    @subscribed(keep=1)
    def guard(self, message: Guard) -> None:
        self._clear = message.clear

    @subscribed(keep=1)
    def view(self, message: Picture) -> None:
        size = cell.WIDTH * LARGER, cell.HEIGHT * LARGER
        large = cv2.resize(message.pixels, size, interpolation=cv2.INTER_CUBIC)
        scene = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
        tracks = self._tracks
        for x, y in tracks.places.tolist() if tracks else ():
            column, row = cell.pixel(x, y)
            at = LARGER * column, LARGER * row
            cv2.circle(scene, at, 40, YELLOW, 2, cv2.LINE_AA)
        words = "running" if self._clear else "STOPPED: a person"
        cv2.putText(scene, words, (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, YELLOW, 2)
        _, coded = cv2.imencode(".jpg", scene, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        if (age := self.clock.since(message.taken)) is not None:
            self._screen.send(self.clock.now() - age.value, bytes(coded))

    def cleanup(self) -> None:
        self._screen.close()
