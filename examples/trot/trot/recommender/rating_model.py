"""Predicts what we like from what all viewers watch.

Alternating least squares for implicit feedback (Hu, Koren and Volinsky, 2008), with
the library implicit. It goes on from its last factors when new data have come.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, every, subscribed
from trot.interfaces import Ratings
from trot.messages import Watched
from trot.recommender.audience import PROGRAMMES, US, VIEWERS

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of its progress bars
    from implicit.cpu.als import AlternatingLeastSquares
    from scipy.sparse import csr_matrix
    from threadpoolctl import threadpool_limits

FACTORS = 16
REGULARISATION = 5.0


class Counts(Message, frozen=True):
    """What a model hands to its successor: who watched what how often."""

    counts: NDArray[np.float32]


class RatingModel(Component):
    """Improves its factors by all that was watched, once a second."""

    ratings: Provided[Ratings]

    def configure(self) -> None:
        self._counts = np.zeros((VIEWERS, PROGRAMMES), np.float32)
        self._is_new = False
        # Two threads that wait for each other take longer than one.
        threadpool_limits(1, "blas")
        self._model = AlternatingLeastSquares(
            factors=int(self.parameters.get("factors", FACTORS)),
            regularization=REGULARISATION,
            iterations=1,
            num_threads=1,
            random_state=0,
        )

    @subscribed(keep=64)
    def watched(self, message: Watched) -> None:
        np.add.at(self._counts, (message.pairs[:, 0], message.pairs[:, 1]), 1)
        self._is_new = True

    @every(1.0)
    def learn(self) -> None:
        if self._is_new:
            self._is_new = False
            self._model.fit(csr_matrix(self._counts), show_progress=False)

    def predict(self, numbers: list[int]) -> list[float]:
        if self._model.item_factors is None:
            return [0.0] * len(numbers)
        likings = self._model.item_factors[numbers] @ self._model.user_factors[US]
        return [float(liking) for liking in likings]

    def snapshot(self) -> Counts:
        return Counts(self._counts)

    def restore(self, state: Counts) -> None:
        self._counts = state.counts.copy()
        self._is_new = True
