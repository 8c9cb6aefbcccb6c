"""The television: it tells who watches what, and judges what the robot recommends."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trot.packets import unpack_recommended
from trot.recommender.audience import Audience, on_air

PERIOD = 0.1
"""[s] from packet to packet."""

BEFORE, EACH = 20_000, 20
"""Programmes that were watched before the start, and in each period."""


class Television:
    """Packets of what is watched, and how good recommendations are."""

    def __init__(self, seed: int = 0) -> None:
        # The guide is of seed 0; who watches what is of the run's.
        self._audience = Audience()
        self._audience.reseed(seed)
        self._before = np.array_split(self._audience.watch(BEFORE), 8)
        self._judged: list[bool] = []
        self._delays: list[float] = []

    def watched(self) -> NDArray[np.int32]:
        """Return who watched what in the last period; at first, what was before."""
        return self._before.pop() if self._before else self._audience.watch(EACH)

    def take(self, packet: bytes, now: float, asked: float) -> None:
        """See what the robot recommends.

        Parameters
        ----------
        now
            [s]
        asked
            When somebody ended to ask for it [s]; 0 when nobody did.
        """
        wished, slot, numbers = unpack_recommended(packet)
        shown = on_air(slot)
        self._judged += [self._audience.is_good(number, shown) for number in numbers]
        if wished and asked:
            self._delays.append(now - asked)

    def result(self) -> dict[str, Any]:
        """Return the share of good recommendations, and their median delay [s]."""
        good = float(np.mean(self._judged)) if self._judged else None
        return {
            "recommended": len(self._judged),
            "good_recommendations": None if good is None else round(good, 3),
            "recommendation_seconds": (
                round(float(np.median(self._delays)), 3) if self._delays else None
            ),
        }
