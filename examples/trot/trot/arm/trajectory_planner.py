"""Finds a way for the arm on which it touches nothing.

RRT-Connect (Kuffner and LaValle, 2000): two trees of postures grow towards each other.
Then shortcuts make the way shorter; their number is this component's load.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, subscribed
from trot.arm import arm_model
from trot.arm.arm_model import ArmModel
from trot.messages import Joints, Reach, Trajectory

STRIDE = 0.05
"""[rad] Postures this far apart are looked at along a way."""

GROWTH = 0.4
"""[rad] A tree grows by this much at once."""

MOST = 1500
"""Branches that are tried at most."""

SHORTCUTS = 400
SPEED = 1.6
"""[rad/s] of the quickest joint."""

STEP = 0.02
"""[s] from posture to posture of a trajectory."""

Postures = NDArray[np.float64]
"""Angles [rad], ``(n, 6)``."""


class TrajectoryPlanner(Component):
    """Publishes a trajectory for each reach, from where the arm is."""

    trajectory: Published[Trajectory]

    def configure(self) -> None:
        shortcuts = int(self.parameters.get("shortcuts", SHORTCUTS))
        self._planners = {
            carries: WayPlanner(ArmModel(carries=carries), shortcuts)
            for carries in (False, True)
        }
        self._angles = np.array(arm_model.REST)

    @subscribed(keep=1)
    def joints(self, message: Joints) -> None:
        self._angles = message.angles.astype(float)

    @subscribed(keep=2)
    def reach(self, message: Reach) -> None:
        planner = self._planners[message.carries]
        way = planner.way(self._angles, message.angles.astype(float))
        if way is None:
            self.log.info("the arm finds no way for reach %d", message.number)
            return
        angles = timed(way).astype(np.float32)
        self.trajectory.publish(
            Trajectory(message.stamp, message.number, angles, message.closes)
        )


class WayPlanner:
    """Finds ways between postures.

    Parameters
    ----------
    arm
        What touches what.
    shortcuts
        How many are tried.
    """

    def __init__(self, arm: ArmModel, shortcuts: int = SHORTCUTS) -> None:
        self._arm, self._shortcuts = arm, shortcuts
        self._random = np.random.default_rng(0)

    def way(self, start: Postures, goal: Postures) -> Postures | None:
        """Return postures from `start` to `goal` with free straight ways between."""
        if self._is_free(start, goal):
            return np.array([start, goal])
        found = self._connect(start, goal)
        return None if found is None else self._shortened(found)

    def _connect(self, start: Postures, goal: Postures) -> Postures | None:
        low, high = self._arm.limits.T
        trees = [[(start, -1)], [(goal, -1)]]
        for turn in range(MOST):
            here, there = trees[turn % 2], trees[1 - turn % 2]
            new = self._grow(here, self._random.uniform(low, high))
            if new is None:
                continue
            near = min(there, key=lambda node: float(np.abs(node[0] - new).max()))[0]
            if self._is_free(new, near):
                there_end = next(i for i, n in enumerate(there) if n[0] is near)
                ways = [_branch(here, len(here) - 1), _branch(there, there_end)]
                first, last = ways if turn % 2 == 0 else ways[::-1]
                return np.array(first + last[::-1])
        return None

    def _grow(
        self, tree: list[tuple[Postures, int]], towards: Postures
    ) -> Postures | None:
        """Add a posture nearer to `towards` to a tree, and return it; None: no room."""
        known = np.array([node for node, _ in tree])
        nearest = int(np.abs(known - towards).max(axis=1).argmin())
        step = towards - known[nearest]
        step *= min(1.0, GROWTH / max(1e-9, float(np.abs(step).max())))
        new = known[nearest] + step
        if not self._is_free(known[nearest], new):
            return None
        tree.append((new, nearest))
        return np.asarray(new)

    def _shortened(self, way: Postures) -> Postures:
        points = list(way)
        for _ in range(self._shortcuts):
            # Between any two points on the way, not only between its corners.
            legs = len(points) - 1
            first, last = np.sort(self._random.uniform(0, legs, 2))
            low, high = int(first), int(last)
            if low == high:
                continue
            one = points[low] + (first - low) * (points[low + 1] - points[low])
            other = points[high] + (last - high) * (points[high + 1] - points[high])
            if self._is_free(one, other):
                points[low + 1 : high + 1] = [one, other]
        return np.array(points)

    def _is_free(self, one: Postures, other: Postures) -> bool:
        count = int(np.abs(other - one).max() / STRIDE) + 2
        between = np.linspace(one, other, count)
        return not any(self._arm.touches(posture) for posture in between[1:])


def _branch(tree: list[tuple[Postures, int]], end: int) -> list[Postures]:
    """Return the postures from a tree's root to a node."""
    found = []
    while end >= 0:
        posture, end = tree[end]
        found.append(posture)
    return found[::-1]


def timed(way: Postures) -> Postures:
    """Return postures `STEP` apart along a way that starts and ends without speed."""
    lengths = np.abs(np.diff(way, axis=0)).max(axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    seconds = max(0.2, 1.5 * along[-1] / SPEED)
    share = np.linspace(0, 1, max(2, round(seconds / STEP)))
    eased = along[-1] * share**2 * (3 - 2 * share)
    columns = [np.interp(eased, along, way[:, joint]) for joint in range(way.shape[1])]
    return np.stack(columns, axis=1)
