"""Solves how the arm has to bend for its hand to be somewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Provided
from trot.arm import geometry
from trot.effort import Block, Effort
from trot.interfaces import Kinematics

ITERATIONS = 20
DAMPING = 0.02
NUDGE = 1e-4
"""[rad] for the numerical Jacobian."""


class ArmKinematics(Component):
    """Damped least squares from the present posture, then from many others."""

    kinematics: Provided[Kinematics]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)

    def solve(
        self, target: NDArray[np.float32], start: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        since = self._effort.start()
        wanted = target.astype(float)
        best = solve(wanted, start, ITERATIONS)

        def retry(block: Block) -> None:
            nonlocal best
            guess = best + (block[: geometry.JOINTS] - np.float32(0.5))
            other = solve(wanted, guess, 2)
            best = min(best, other, key=lambda angles: miss(wanted, angles))

        self._effort.spend(retry, since)
        return best


def solve(
    target: NDArray[np.float64], start: geometry.Angles, iterations: int
) -> NDArray[np.float32]:
    """Return angles that bring the hand nearer to `target` [m] than `start` does."""
    angles = start.astype(float)
    nudges = np.eye(geometry.JOINTS) * NUDGE
    for _ in range(iterations):
        here = geometry.hand(angles)
        there = geometry.hand(angles + nudges)
        jacobian = ((there - here) / NUDGE).T
        square = jacobian @ jacobian.T + DAMPING * np.eye(3)
        angles += jacobian.T @ np.linalg.solve(square, target - here)
    return angles.astype(np.float32)


def miss(target: NDArray[np.float64], angles: geometry.Angles) -> float:
    """Return how far [m] the hand is from `target`."""
    return float(np.linalg.norm(target - geometry.hand(angles)))
