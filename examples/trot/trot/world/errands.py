"""Which of the robot's tasks came to a good end, as one sees in the flat."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from trot import home
from trot.world.functions import GOOD, SHOWN
from trot.world.simulation import Simulation
from trot.world.walk import LENGTH, Walk

SERVED = 1.2
"""[m] A cup that the robot brings this near is served."""

NEAR, TOGETHER = 1.6, 2.0
"""[m] Who follows is this near at the end, and on the way in the mean."""

IN_KITCHEN = 1.0
"""[m] from the goal in the kitchen."""


class Errands:
    """Watches robot, cup and person."""

    def __init__(self, simulation: Simulation, walk: Walk) -> None:
        self._simulation, self._walk = simulation, walk
        self._placed_before: int | None = None
        self._has_cup = False
        self.served_after: float | None = None
        """[s] When the robot came to the person with a cup from the kitchen."""
        self._gaps: list[float] = []

    def look(self) -> None:
        """Look once; to be called every step."""
        now, placed = self._simulation, self._simulation.hand.placed
        if math.dist(now.pose[:2], home.GOAL) < IN_KITCHEN:
            if self._placed_before is None:
                self._placed_before = placed
            self._has_cup = self._has_cup or placed > self._placed_before
        elif self._has_cup and self.served_after is None and self._gap() < SERVED:
            self.served_after = now.now
        if self._walk.is_walking:
            self._gaps.append(self._gap())

    def _gap(self) -> float:
        return math.dist(self._simulation.pose[:2], self._walk.place)

    def values(self) -> dict[str, dict[str, Any]]:
        """Return what was measured of each task."""
        gap = round(float(np.mean(self._gaps)), 2) if self._gaps else None
        return {
            "serve_beverage": {
                "served_after": self.served_after and round(self.served_after, 1),
                "cups_dropped": self._simulation.hand.dropped,
            },
            "follow_person": {
                "walked": round(self._walk.walked, 2),
                "gap_mean": gap,
                "gap_at_end": round(self._gap(), 2),
            },
        }


_UNITS = {"served_after": "s", "walked": "m", "gap_mean": "m", "gap_at_end": "m"}


def tasks(
    values: Mapping[str, Mapping[str, Any]], result: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return name, success and values of each task, as `criteria` of functions."""
    served, followed = values["serve_beverage"], values["follow_person"]
    delay, good = result["recommendation_seconds"], result["good_recommendations"]
    shown = {"recommendation_seconds": delay, "good_recommendations": good}
    success = {
        "serve_beverage": served["served_after"] is not None
        and served["cups_dropped"] == 0,
        "follow_person": followed["walked"] >= LENGTH - 0.01
        and followed["gap_mean"] <= TOGETHER
        and followed["gap_at_end"] <= NEAR,
        "recommend_tv": delay is not None and delay <= SHOWN and (good or 0.0) >= GOOD,
    }
    success["evening"] = all(success.values())
    measured = {**values, "recommend_tv": shown, "evening": {}}
    units = {**_UNITS, "recommendation_seconds": "s"}
    return [
        {
            "name": name,
            "success": bool(success[name]),
            "values": {
                key: {"value": value, "unit": units.get(key, "")}
                for key, value in measured[name].items()
            },
        }
        for name in success
    ]
