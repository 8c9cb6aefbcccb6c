"""Learns what we like from what we watch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, Published, every
from trot.device import Device
from trot.interfaces import Tastes
from trot.messages import Watched
from trot.packets import unpack_watched
from trot.recommender.audience import GENRES, US, Audience

FADES = 0.98
"""The weight of what was watched one programme earlier."""


class Liking(Message, frozen=True):
    """How much of each genre was watched, ``(GENRES,)``."""

    watched: NDArray[np.float64]


class ViewerProfile(Component):
    """Reads who watches what, hands it on, and keeps our share of each genre."""

    tastes: Provided[Tastes]
    watched: Published[Watched]

    def configure(self) -> None:
        self._television = Device(self.device("television"))
        self._genres = Audience().genres
        self._watched = np.full(GENRES, 0.1)

    def weights(self) -> NDArray[np.float64]:
        return np.asarray(self._watched / self._watched.sum())

    @every(0.1)
    def read(self) -> None:
        for packet in self._television.receive():
            pairs = unpack_watched(packet)
            for programme in pairs[pairs[:, 0] == US, 1]:
                self._watched = FADES * self._watched + self._genres[programme]
            self.watched.publish(Watched(self.clock.now(), pairs))

    def snapshot(self) -> Liking:
        return Liking(self._watched)

    def restore(self, state: Liking) -> None:
        self._watched = state.watched.copy()

    def cleanup(self) -> None:
        self._television.close()
