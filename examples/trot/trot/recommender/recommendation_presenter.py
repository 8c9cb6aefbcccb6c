"""Recommends programmes: to the television, and as a panel for the screen."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Published, Required, every, subscribed
from trot.device import Device
from trot.interfaces import Guide, Ratings, Tastes
from trot.messages import Image, Programme, Wish
from trot.packets import pack_recommended

HEIGHT, WIDTH = 150, 240
SHOWN = 3
BY_GENRE = 0.5
"""The weight of the share of genres against what the rating model says."""


class RecommendationPresenter(Component):
    """Publishes a panel twice a second, and tells the television when it is asked.

    That it did so ends the action of a task.
    """

    guide: Required[Guide]
    tastes: Required[Tastes]
    ratings: Required[Ratings]
    panel: Published[Image]
    shown: Published[bool]

    def configure(self) -> None:
        self._remote_control = Device(self.device("remote_control"))

    @subscribed(keep=1)
    def wish(self, message: Wish) -> None:
        if self._recommend(wished=message.stamp):
            self.shown.publish(True)

    @every(0.5, deadline=0.5)
    def present(self) -> None:
        self._recommend()

    def cleanup(self) -> None:
        self._remote_control.close()

    def _recommend(self, wished: float = 0.0) -> bool:
        """Recommend what is best; return whether that was known."""
        try:
            programmes, scores = self._choose()
        except CallError as error:
            self.log.debug("nothing to recommend: %s", error)
            return False
        numbers = [each.number for each in programmes]
        packet = pack_recommended(wished, programmes[0].slot, numbers)
        self._remote_control.send(packet)
        self.panel.publish(Image(self.clock.now(), draw(programmes, scores)))
        return True

    def _choose(self) -> tuple[list[Programme], list[float]]:
        """Return the best programmes on the air, and how good they seem."""
        programmes = self.guide.on_air()
        weights = self.tastes.weights()
        rated = self.ratings.predict([each.number for each in programmes])
        genres = [float(np.frombuffer(each.genres) @ weights) for each in programmes]
        scores = _scaled(rated) + BY_GENRE * _scaled(genres)
        best = np.argsort(-scores)[:SHOWN]
        return [programmes[number] for number in best], scores[best].tolist()


def _scaled(values: list[float]) -> NDArray[np.float64]:
    """Return values from 0 to 1, or all 0 when they are alike."""
    array = np.array(values)
    width = array.max() - array.min()
    return (array - array.min()) / width if width > 0 else np.zeros(len(array))


def draw(programmes: list[Programme], scores: list[float]) -> NDArray[np.uint8]:
    """Return a panel ``(HEIGHT, WIDTH, 3)``: a title and a bar for each programme."""
    panel = np.full((HEIGHT, WIDTH, 3), (60, 40, 30), np.uint8)
    for place, (programme, score) in enumerate(zip(programmes, scores, strict=True)):
        top = 10 + place * 46
        width = round((WIDTH - 20) * min(1.0, score / (1 + BY_GENRE)))
        cv2.rectangle(panel, (10, top + 26), (10 + width, top + 34), (90, 200, 90), -1)
        where = (10, top + 18)
        cv2.putText(
            panel,
            programme.title,
            where,
            cv2.FONT_HERSHEY_SIMPLEX,
            0.6,
            (255,) * 3,
            1,
            16,
        )
    return panel
