"""Understands what somebody said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Speech, Utterance

INTENTS = ("greet", "bring", "television", "stop", "chat")
QUIET = 4.0
"""The mean log energy of features below which nobody spoke."""


class UtteranceParser(Component):
    """Compares speech with stored examples by dynamic time warping."""

    utterance: Published[Utterance]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._features: NDArray[np.float32] | None = None

    @subscribed(keep=1)
    def speech(self, message: Speech) -> None:
        self._features = message.features

    @every(0.1)
    def understand(self) -> None:
        since = self._effort.start()
        features, self._features = self._features, None
        self._effort.spend(_warp, since)
        if features is None or features.mean() < QUIET:
            return
        level = float(features.mean())
        intent = INTENTS[int(level * 10) % len(INTENTS)]
        confidence = level / (level + QUIET)
        self.utterance.publish(Utterance(self.clock.now(), intent, confidence))


def _warp(block: Block) -> float:
    """Return the cost of warping one stored example onto another."""
    one, other = block[: 64 * 16].reshape(64, 16), block[-64 * 16 :].reshape(64, 16)
    cost = np.abs(one[:, None] - other[None]).sum(axis=2)
    best = np.cumsum(cost[0])
    for row in cost[1:]:
        best = row + np.minimum(best, np.concatenate([best[:1], best[:-1]]))
    return float(best[-1])
