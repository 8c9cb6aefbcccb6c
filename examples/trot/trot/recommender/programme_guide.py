"""Knows what is on television."""

from __future__ import annotations

import numpy as np

from poise import Component, Provided, every
from trot.effort import Block, Effort
from trot.interfaces import Guide
from trot.messages import Programme

PROGRAMMES = 2000
GENRES = 16
ANSWERS = 20
"""Programmes that a search returns at most."""


class ProgrammeGuide(Component):
    """A guide of a week, and an index that it goes on sorting."""

    guide: Provided[Guide]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        random = np.random.default_rng(7)
        self._starts = np.sort(random.uniform(0, 7 * 86_400, PROGRAMMES))
        self._genres = random.integers(0, GENRES, PROGRAMMES)

    def search(self, genre: int) -> list[Programme]:
        numbers = np.nonzero(self._genres == genre)[0][:ANSWERS]
        return [
            Programme(int(n), f"Programme {n}", genre, float(self._starts[n]))
            for n in numbers
        ]

    @every(0.1)
    def index(self) -> None:
        self._effort.spend(_sort, self._effort.start())


def _sort(block: Block) -> Block:
    """Return a part of the index in order."""
    return np.sort(block[:8192])
