"""Predicts ratings by matrix factorisation (Koren et al., 2009)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, every
from trot.effort import Block, Effort
from trot.interfaces import Ratings
from trot.recommender.programme_guide import PROGRAMMES

VIEWERS = 200
FACTORS = 8
BATCH = 512
"""Ratings in a step of the descent."""

RATE, DECAY = 0.05, 0.02


class Factors(Message, frozen=True):
    """The factors of viewers and of programmes, ``(n, FACTORS)``."""

    viewers: NDArray[np.float32]
    programmes: NDArray[np.float32]


class RatingModel(Component):
    """Goes on with stochastic gradient descent over a large table of ratings.

    The blocks of the working set are the table: of each three numbers, the first two
    say who rated what, and the third is the rating.
    """

    ratings: Provided[Ratings]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        random = np.random.default_rng(11)
        self._viewers = random.normal(0.3, 0.1, (VIEWERS, FACTORS)).astype(np.float32)
        shape = (PROGRAMMES, FACTORS)
        self._programmes = random.normal(0.3, 0.1, shape).astype(np.float32)

    def predict(self, numbers: list[int]) -> list[float]:
        viewer = self._viewers[0]
        return [float(self._programmes[n % PROGRAMMES] @ viewer) for n in numbers]

    @every(0.1)
    def learn(self) -> None:
        self._effort.spend(self._descend, self._effort.start())

    def snapshot(self) -> Factors:
        return Factors(self._viewers.copy(), self._programmes.copy())

    def restore(self, state: Factors) -> None:
        self._viewers = state.viewers.copy()
        self._programmes = state.programmes.copy()

    def _descend(self, block: Block) -> float:
        """Take one step over a batch of ratings; return the error before it."""
        table = block[: 3 * BATCH].reshape(BATCH, 3)
        who = (table[:, 0] * VIEWERS).astype(np.intp)
        what = (table[:, 1] * PROGRAMMES).astype(np.intp)
        viewers, programmes = self._viewers[who], self._programmes[what]
        error = table[:, 2] - (viewers * programmes).sum(axis=1)
        step = RATE * error[:, None]
        np.add.at(self._viewers, who, step * programmes - RATE * DECAY * viewers)
        np.add.at(self._programmes, what, step * viewers - RATE * DECAY * programmes)
        return float(np.square(error).mean())
