"""Finds the way: a wave that spreads from the goal over the free cells of the map."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from poise import CallError, Component, Message, Published, Required, every, subscribed
from trot import home
from trot.interfaces import Maps, Poses
from trot.messages import Path, Pose, Seen
from trot.navigator import grid
from trot.navigator.follower import Follower
from trot.navigator.mapper import occupied

COARSE = 1
"""Cells of the map to a side of a cell that the planner uses: 5 cm."""

CELL = COARSE * grid.CELL
CLEARANCE = home.ROBOT_RADIUS + 0.05
"""[m] Nearer to an obstacle than this there is no way."""

COMFORT = 0.55
"""[m] Nearer than this a way is dearer."""

BLOCKED = np.float32(np.inf)

Points = NDArray[np.float32]
"""x, y [m], ``(n, 2)``."""


ARRIVED = 0.2
"""[m] Who is this near a goal, and was at the plan before, is there."""


class Errand(Message, frozen=True):
    """The action that a planner hands to its successor."""

    action: str


class PathPlanner(Component):
    """Plans anew twice a second, from where the robot is on the map as it is.

    The parameter `goals` says where to: for each action of a task a place, or the
    person. Who has no action drives to all places in turn, again and again.
    """

    poses: Required[Poses]
    maps: Required[Maps]
    path: Published[Path]
    arrived: Published[bool]

    def configure(self) -> None:
        goals = self.parameters.get("goals", {"drive": home.GOAL})
        self._places = {
            name: (float(place[0]), float(place[1]))
            for name, place in goals.items()
            if place != "person"
        }
        self._turns = deque(dict.fromkeys(self._places.values()))
        self._action = ""
        self._was_there = False
        self._follower = Follower()

    def begin(self, action: str) -> None:
        """Drive where the action leads to, and say when the robot is there."""
        self._action = action
        self._was_there = False
        self._follower = Follower()

    @subscribed(keep=1)
    def seen(self, message: Seen) -> None:
        """Note where the person is that is to be followed."""
        try:
            pose = self.poses.latest_pose()
        except CallError as error:
            self.log.debug("somebody is seen from nowhere: %s", error)
            return
        self._follower.note(pose, message)

    @every(0.5)
    def plan(self) -> None:
        try:
            pose, seen = self.poses.latest_pose(), self.maps.latest_map()
        except CallError as error:
            self.log.debug("no plan this time: %s", error)
            return
        goal = self._goal(pose)
        if goal is None:
            return
        points = way(seen.cells, (pose.x, pose.y), goal)
        self.path.publish(Path(pose.stamp, points))

    def snapshot(self) -> Errand:
        return Errand(self._action)

    def restore(self, state: Errand) -> None:
        self._action = state.action

    def _goal(self, pose: Pose) -> tuple[float, float] | None:
        """Return where to drive now, and say when the robot is there."""
        if self._action and self._action not in self._places:
            if self._follower.is_there(pose, self.clock.now()):
                self._arrive()
            return self._follower.goal(self.clock.now())
        goal = self._places.get(self._action, self._turns[0])
        is_there = math.dist((pose.x, pose.y), goal) < ARRIVED
        if is_there and self._was_there:
            self._arrive()
        self._was_there = is_there
        return goal

    def _arrive(self) -> None:
        """Say that the action is done; without one, go on to the next place."""
        if self._action:
            self.arrived.publish(True)
        else:
            self._turns.rotate(-1)


def way(
    cells: grid.Cells, start: tuple[float, float], goal: tuple[float, float]
) -> Points:
    """Return the cheapest way from `start` to `goal` [m]; empty when there is none.

    Parameters
    ----------
    cells
        Occupancy, ``(grid.SIZE, grid.SIZE)``; unknown cells count as free.
    """
    cost = costs(cells)
    here, there = _cell(start), _cell(goal)
    _free_around(cost, here)
    reached = _wave(cost, there, here)
    if reached[here] == BLOCKED:
        return np.zeros((0, 2), np.float32)
    return _downhill(reached, here)


def costs(cells: grid.Cells) -> grid.Distances:
    """Return what a metre costs in each coarse cell: 1 in the open, to `BLOCKED`."""
    size = grid.SIZE // COARSE
    blocks = occupied(cells).reshape(size, COARSE, size, COARSE)
    room = grid.distance(np.asarray(blocks.any(axis=(1, 3))), COMFORT, CELL)
    tight = 1 + 4 * ((COMFORT - room) / (COMFORT - CLEARANCE)) ** 2
    return np.where(room < CLEARANCE, BLOCKED, tight).astype(np.float32)


def _free_around(cost: grid.Distances, here: tuple[int, int]) -> None:
    """Let the robot out of where it stands, however near an obstacle that is."""
    row, column = here
    near = round(0.2 / CELL)
    rows = slice(max(0, row - near), row + near + 1)
    around = cost[rows, max(0, column - near) : column + near + 1]
    np.minimum(around, 20, out=around)


def _wave(
    cost: grid.Distances, source: tuple[int, int], target: tuple[int, int]
) -> grid.Distances:
    """Return what the way from each cell to `source` costs."""
    size = len(cost)
    padded = np.full((size + 2, size + 2), BLOCKED, np.float32)
    reached = padded[1:-1, 1:-1]
    reached[source] = 0
    steps = [
        (down, right, cost * np.float32(CELL * math.hypot(down, right)))
        for down, right in grid.NEIGHBOURS
    ]
    for _ in range(4 * size):
        before = reached.copy()
        for down, right, step in steps:
            np.minimum(reached, grid.shifted(padded, down, right) + step, out=reached)
        # Nothing that still changes can make the target's way cheaper.
        changed = before != reached
        if not changed.any() or reached[changed].min() >= reached[target]:
            break
    return reached


def _downhill(reached: grid.Distances, here: tuple[int, int]) -> Points:
    """Follow the falling cost from `here` to the goal."""
    row, column = here
    cells = [here]
    while reached[row, column] > 0 and len(cells) < reached.size:
        row, column = min(
            ((row + down, column + right) for down, right in grid.NEIGHBOURS),
            key=lambda cell: _at(reached, cell),
        )
        cells.append((row, column))
    return np.array([_centre(cell) for cell in cells], np.float32)


def _at(reached: grid.Distances, cell: tuple[int, int]) -> float:
    row, column = cell
    inside = 0 <= row < len(reached) and 0 <= column < len(reached)
    return float(reached[cell]) if inside else math.inf


def _cell(point: tuple[float, float]) -> tuple[int, int]:
    """Return row and column of the coarse cell at x, y [m]."""
    row = grid.row(np.array(point[1]))
    column = grid.column(np.array(point[0]))
    return int(row) // COARSE, int(column) // COARSE


def _centre(cell: tuple[int, int]) -> tuple[float, float]:
    row, column = cell
    return (
        grid.ORIGIN[0] + (column + 0.5) * CELL,
        grid.ORIGIN[1] + (row + 0.5) * CELL,
    )
