"""Shows what to watch, as a panel of thumbnails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Published, Required, every, subscribed
from trot.effort import Block, Effort
from trot.interfaces import Guide, Ratings, Tastes
from trot.messages import Image, Wish

HEIGHT, WIDTH = 120, 160
SHOWN = 4


class RecommendationPresenter(Component):
    """Publishes a panel twice a second: the best programmes of the wished genre."""

    guide: Required[Guide]
    tastes: Required[Tastes]
    ratings: Required[Ratings]
    panel: Published[Image]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._genre: int | None = None

    @subscribed(keep=1)
    def wish(self, message: Wish) -> None:
        self._genre = message.genre

    @every(0.5)
    def present(self) -> None:
        since = self._effort.start()
        try:
            numbers = self._choose()
        except CallError as error:
            self.log.info("nothing to recommend: %s", error)
            return
        pixels = draw(numbers)
        self._effort.spend(_blur, since)
        self.panel.publish(Image(self.clock.now(), pixels))

    def _choose(self) -> list[int]:
        """Return the numbers of the programmes to show, best first."""
        likings = self.tastes.weights()
        genre = int(likings.argmax()) if self._genre is None else self._genre
        numbers = [programme.number for programme in self.guide.search(genre)]
        rated = zip(self.ratings.predict(numbers), numbers, strict=True)
        return [number for _, number in sorted(rated, reverse=True)[:SHOWN]]


def draw(numbers: list[int]) -> NDArray[np.uint8]:
    """Return a panel ``(HEIGHT, WIDTH, 3)`` with a pattern for each programme."""
    panel = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    y, x = np.mgrid[0 : HEIGHT // 2, 0 : WIDTH // 2]
    for place, number in enumerate(numbers):
        top, left = divmod(place, 2)
        waves = 128 + 127 * np.sin((x * (1 + number % 7) + y * (1 + number % 5)) / 20)
        part = (
            slice(top * HEIGHT // 2, (top + 1) * HEIGHT // 2),
            slice(left * WIDTH // 2, (left + 1) * WIDTH // 2),
        )
        panel[part] = np.stack([waves, 255 - waves, waves / 2], axis=-1)
    return panel


def _blur(block: Block) -> Block:
    """Return a stored thumbnail, smoothed to be scaled down."""
    picture = block.reshape(128, 128)
    total = picture[:-1, :-1] + picture[1:, :-1] + picture[:-1, 1:]
    return total / np.float32(3)
