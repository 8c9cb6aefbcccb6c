"""Finds out where the robot is: a particle filter on the walls that it knows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, Published, Stamp, subscribed
from trot import home
from trot.interfaces import Poses
from trot.laser_model import ANGLES, MAX_RANGE
from trot.messages import LocatedScan, Pose, Scan
from trot.navigator import grid

BEAM_STEP = 3
"""Every third beam decides: neighbours say much the same."""

SIGMA = 0.1
"""[m] How far a beam may end from a wall and still speak for it."""

UNMAPPED = 0.1
"""The likelihood of a beam that ends on something that is no wall."""

TRUST = 0.15
"""Beams are not independent: so much of what each one says is believed."""

PART = 200
"""Particles that are weighed at once."""

Particles = NDArray[np.float64]
"""x [m], y [m], heading [rad] of each particle, ``(n, 3)``."""


class Belief(Message, frozen=True):
    """What a localiser hands to its successor."""

    particles: NDArray[np.float64]
    pose: Pose
    odometry: Pose | None


class Localiser(Component):
    """Publishes every scan with its pose, and tells the latest pose when asked."""

    poses: Provided[Poses]
    located: Published[LocatedScan]

    def configure(self) -> None:
        self._random = np.random.default_rng(0)
        count = int(self.parameters.get("particles", 2000))
        start = self.parameters.get("start", home.START)
        spread = self._random.normal(0, 1, (count, 3)) * (0.1, 0.1, 0.05)
        self._particles: Particles = np.asarray(start, float) + spread
        self._pose = Pose(self.clock.stamp(), *map(float, start))
        self._odometry: Pose | None = None
        field = grid.distance(grid.walls(), 1.0, grid.CELL).astype(float)
        self._likelihood = np.log(UNMAPPED + np.exp(-((field / SIGMA) ** 2) / 2))
        self._ranges = np.zeros(0, np.float32)

    def latest_pose(self) -> Pose:
        return self._pose

    @subscribed(keep=1)
    def scan(self, message: Scan) -> None:
        self._ranges = message.ranges
        self._move(message.odometry)
        weights = self._weigh()
        self._pose = _mean(message.stamp, self._particles, weights)
        if 1 / np.sum(weights**2) < len(weights) / 2:
            self._resample(weights)
        self.located.publish(LocatedScan(self._pose, message.ranges))

    def snapshot(self) -> Belief:
        return Belief(self._particles, self._pose, self._odometry)

    def restore(self, state: Belief) -> None:
        self._particles = state.particles.copy()
        self._pose = state.pose
        self._odometry = state.odometry

    def _move(self, odometry: Pose) -> None:
        """Move the particles as the wheels counted, with noise."""
        last, self._odometry = self._odometry, odometry
        if last is None:
            return
        length = math.hypot(odometry.x - last.x, odometry.y - last.y)
        direction = math.atan2(odometry.y - last.y, odometry.x - last.x)
        forward = length * math.cos(direction - last.heading)
        turn = odometry.heading - last.heading
        noise = self._random.normal(0, 1, self._particles.shape)
        heading = self._particles[:, 2] + turn / 2
        self._particles[:, 0] += forward * np.cos(heading)
        self._particles[:, 1] += forward * np.sin(heading)
        self._particles[:, 2] += turn
        scale = (0.005 + 0.1 * length, 0.005 + 0.1 * length, 0.003 + 0.1 * abs(turn))
        self._particles += noise * scale

    def _weigh(self) -> NDArray[np.float64]:
        """Return how well each particle explains the scan; the sum is 1."""
        score = TRUST * self._score(self._particles)
        weights = np.exp(score - score.max())
        return np.asarray(weights / weights.sum())

    def _score(self, poses: Particles) -> NDArray[np.float64]:
        """Return the log likelihood of the scan from each pose, ``(n,)``."""
        ranges, angles = self._ranges[::BEAM_STEP], ANGLES[::BEAM_STEP]
        hits = ranges < MAX_RANGE - 0.05
        ranges, angles = ranges[hits].astype(float), angles[hits]
        scores = np.empty(len(poses))
        # In parts that stay in the cache: twice as quick as all at once.
        for first in range(0, len(poses), PART):
            part = poses[first : first + PART]
            directions = part[:, 2:] + angles
            x = part[:, :1] + ranges * np.cos(directions)
            y = part[:, 1:2] + ranges * np.sin(directions)
            likelihood = self._likelihood[grid.row(y), grid.column(x)]
            scores[first : first + PART] = likelihood.sum(axis=1)
        return scores

    def _resample(self, weights: NDArray[np.float64]) -> None:
        """Draw particles by weight, evenly spaced over the cumulated weights."""
        count = len(weights)
        ticks = (np.arange(count) + self._random.random()) / count
        chosen = np.searchsorted(np.cumsum(weights), ticks)
        self._particles = self._particles[np.minimum(chosen, count - 1)]


def _mean(stamp: Stamp, particles: Particles, weights: NDArray[np.float64]) -> Pose:
    x, y, _ = weights @ particles
    sine = weights @ np.sin(particles[:, 2])
    cosine = weights @ np.cos(particles[:, 2])
    return Pose(stamp, float(x), float(y), math.atan2(sine, cosine))
