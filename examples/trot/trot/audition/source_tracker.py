"""Finds where the person is who speaks, from bearings taken along the way.

A bearing gives no distance; several ones from different places do. A particle filter
keeps the places in the flat that go with all bearings so far.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Message, Published, Required, subscribed
from trot.interfaces import Poses
from trot.messages import Bearing, Pose, Source

FLAT = (0.0, 0.0, 8.0, 6.0)
"""Left, bottom, right, top [m]."""

SIGMA = 0.15
"""[rad] of bearings."""

OUTLIERS = 0.1
"""The share of bearings that are of echoes."""

WANDER = 0.03
"""[m] that a person may move from bearing to bearing."""


class Places(Message, frozen=True):
    """What a tracker hands to its successor, ``(n, 2)`` [m]."""

    places: NDArray[np.float64]


class SourceTracker(Component):
    """Publishes where the person is after every bearing."""

    poses: Required[Poses]
    source: Published[Source]

    def configure(self) -> None:
        self._random = np.random.default_rng(0)
        count = int(self.parameters.get("particles", 3000))
        self._places = self._random.uniform(FLAT[:2], FLAT[2:], (count, 2))

    @subscribed(keep=2)
    def bearing(self, message: Bearing) -> None:
        try:
            pose = self.poses.latest_pose()
        except CallError as error:
            self.log.debug("a bearing from nowhere: %s", error)
            return
        self._weigh(pose, message.angle)
        x, y = self._places.mean(axis=0)
        spread = float(self._places.std(axis=0).max())
        self.source.publish(Source(message.stamp, float(x), float(y), spread))

    def snapshot(self) -> Places:
        return Places(self._places)

    def restore(self, state: Places) -> None:
        self._places = state.places.copy()

    def _weigh(self, pose: Pose, angle: float) -> None:
        """Keep places that go with a bearing, and draw others again from these."""
        away = self._places - (pose.x, pose.y)
        seen = np.arctan2(away[:, 1], away[:, 0]) - pose.heading
        off = np.angle(np.exp(1j * (seen - angle)))
        weights = np.exp(-((off / SIGMA) ** 2) / 2) + OUTLIERS * SIGMA
        count = len(weights)
        ticks = (np.arange(count) + self._random.random()) / count
        cumulated = np.cumsum(weights / weights.sum())
        chosen = np.minimum(np.searchsorted(cumulated, ticks), count - 1)
        moved = self._random.normal(0, WANDER, (count, 2))
        self._places = np.clip(self._places[chosen] + moved, FLAT[:2], FLAT[2:])
