"""The audience that the television data is made of: a stated generative model.

Every programme has shares of genres, ``f ~ Dirichlet(0.15)``; every viewer has tastes,
``t ~ Dirichlet(0.3)``. A viewer watches the programme ``p`` with a chance proportional
to ``exp(SHARPNESS * f[p] . t)``. So what a viewer likes best is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

VIEWERS, PROGRAMMES, GENRES = 600, 1200, 8
SHARPNESS = 6.0
US = 3
"""The viewer whom the robot recommends to: has a taste that soon shows."""

Floats = NDArray[np.float64]


class Audience:
    """All viewers and programmes.

    Parameters
    ----------
    seed
        Of tastes, genres, and of what is watched.
    """

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng(seed)
        self.genres: Floats = self._random.dirichlet(np.full(GENRES, 0.15), PROGRAMMES)
        """``(PROGRAMMES, GENRES)``"""
        tastes = self._random.dirichlet(np.full(GENRES, 0.3), VIEWERS)
        liking = self.genres @ tastes.T
        self.liking: Floats = liking.T
        """How much viewers like programmes, ``(VIEWERS, PROGRAMMES)``."""
        chance = np.exp(SHARPNESS * self.liking)
        self._cumulated = np.cumsum(chance / chance.sum(axis=1, keepdims=True), axis=1)

    def reseed(self, seed: int) -> None:
        """Let chance, from now on, be of another seed."""
        self._random = np.random.default_rng(seed)

    def watch(self, count: int) -> NDArray[np.int32]:
        """Return who watches what next: viewer and programme, ``(count, 2)``."""
        viewers = self._random.integers(0, VIEWERS, count)
        luck = self._random.random(count)
        chosen = [
            int(np.searchsorted(self._cumulated[viewer], each))
            for viewer, each in zip(viewers, luck, strict=True)
        ]
        programmes = np.array(chosen)
        return np.stack([viewers, np.minimum(programmes, PROGRAMMES - 1)], 1).astype(
            np.int32
        )

    def is_good(self, programme: int, shown: NDArray[np.int32]) -> bool:
        """Return whether we like a programme better than 80 % of what is `shown`."""
        likings = self.liking[US]
        return float((likings[shown] < likings[programme]).mean()) >= 0.8


SLOT = 10.0
"""[s] The programmes on the air change this often."""

CHANNELS = 60


def on_air(slot: int) -> NDArray[np.int32]:
    """Return the programmes that are on the air in a slot, ``(CHANNELS,)``."""
    chance = np.random.default_rng(slot)
    return chance.choice(PROGRAMMES, CHANNELS, replace=False).astype(np.int32)
