"""Follows the objects on the belt by a Kalman filter, also when the camera does not."""

from __future__ import annotations

import numpy as np

from poise import Component, Message, Published, Stamp, subscribed
from sorter.messages import Detections, Tracks

SEEN, NEW, STARTS, CHANGES = 0.003, 0.01, 0.3, 0.15
"""Standard deviations: of a place that is seen, and of a first one [m]; of the belt's
speed at the beginning [m/s], and of its change in a second [m/s]."""

NEAR = 0.06
"""[m] A detection this near a track is the same object."""

GONE = 0.6
"""x [m] behind which nobody wants an object."""


class Belief(Message):
    """The belt's speed [m/s] and the objects' x [m], ``(1 + n,)``; the rest by object.

    All objects ride on one belt, so one filter has them all: those that are seen
    correct those that are seen no more.
    """

    at: float
    mean: list[float]
    covariance: list[list[float]]
    numbers: list[int]
    ys: list[float]
    colours: list[str]


class Tracker(Component):
    """Publishes all objects each time the detector has looked."""

    tracks: Published[Tracks]

    def configure(self) -> None:
        self._at = 0.0
        self._mean, self._covariance = np.zeros(1), np.array([[STARTS**2]])
        self._numbers: list[int] = []
        self._ys: list[float] = []
        self._colours: list[str] = []
        self._last = 0

    @subscribed(keep=2)
    def detections(self, message: Detections) -> None:
        self._predict(message.taken.at)
        for (x, y), colour in zip(message.places, message.colours, strict=True):
            self._see(float(x), float(y), colour)
        for index in reversed(range(len(self._numbers))):
            if self._mean[1 + index] > GONE:
                self._drop(index)
        self.tracks.publish(self._told(message.taken))

    def _predict(self, at: float) -> None:
        passed = min(max(at - self._at, 0.0), 1.0)
        self._at = at
        step = np.eye(len(self._mean))
        step[1:, 0] = passed
        self._mean = step @ self._mean
        self._covariance = step @ self._covariance @ step.T
        self._covariance[0, 0] += CHANGES**2 * passed

    def _see(self, x: float, y: float, colour: str) -> None:
        away = np.hypot(self._mean[1:] - x, np.array(self._ys) - y)
        if not len(away) or away.min() > NEAR:
            self._last += 1
            self._numbers.append(self._last)
            self._ys.append(y)
            self._colours.append(colour)
            self._mean = np.append(self._mean, x)
            self._covariance = np.pad(self._covariance, (0, 1))
            self._covariance[-1, -1] = NEW**2
            return
        index = int(away.argmin())
        row = self._covariance[1 + index]
        gain = row / (row[1 + index] + SEEN**2)
        self._mean = self._mean + gain * (x - self._mean[1 + index])
        self._covariance = self._covariance - np.outer(gain, row)
        self._ys[index] += 0.3 * (y - self._ys[index])

    def _drop(self, index: int) -> None:
        self._mean = np.delete(self._mean, 1 + index)
        for axis in (0, 1):
            self._covariance = np.delete(self._covariance, 1 + index, axis)
        for each in (self._numbers, self._ys, self._colours):
            del each[index]

    def _told(self, taken: Stamp) -> Tracks:
        places = np.column_stack([self._mean[1:], self._ys]).astype(np.float32)
        speed = float(self._mean[0])
        colours = list(self._colours)
        return Tracks(taken, speed, list(self._numbers), places, colours)

    def snapshot(self) -> Belief:
        return Belief(
            self._at,
            self._mean.tolist(),
            self._covariance.tolist(),
            self._numbers,
            self._ys,
            self._colours,
        )

    def restore(self, state: Belief) -> None:
        self._at, self._mean = state.at, np.array(state.mean)
        self._covariance = np.array(state.covariance)
        self._numbers, self._ys = list(state.numbers), list(state.ys)
        self._colours = list(state.colours)
        self._last = max(self._numbers, default=0)
