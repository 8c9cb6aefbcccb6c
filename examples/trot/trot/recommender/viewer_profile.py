"""Learns what the viewer likes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, every
from trot.effort import Block, Effort
from trot.interfaces import Tastes
from trot.recommender.programme_guide import GENRES


class Liking(Message, frozen=True):
    """How much the viewer likes each genre, ``(GENRES,)``."""

    weights: NDArray[np.float32]


class ViewerProfile(Component):
    """A liking for each genre, learnt from a long log of what was watched."""

    tastes: Provided[Tastes]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._weights = np.full(GENRES, 1 / GENRES, np.float32)

    def weights(self) -> NDArray[np.float32]:
        return self._weights

    @every(0.1)
    def learn(self) -> None:
        self._effort.spend(self._replay, self._effort.start())

    def snapshot(self) -> Liking:
        return Liking(self._weights)

    def restore(self, state: Liking) -> None:
        self._weights = state.weights

    def _replay(self, block: Block) -> None:
        """Let a part of the log move the likings a little."""
        watched = np.bincount((block * GENRES).astype(np.intp), minlength=GENRES)
        share = watched[:GENRES] / watched.sum()
        self._weights = (0.99 * self._weights + 0.01 * share).astype(np.float32)
