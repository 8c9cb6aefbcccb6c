"""Keeps the map: the walls that are known, and what the laser sees besides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Provided, subscribed
from trot.interfaces import Maps
from trot.laser_model import ANGLES, MAX_RANGE
from trot.messages import LocatedScan, Map
from trot.navigator import grid

HIT, MISS = 35, -12
"""What one beam adds to the cell where it ends, and to each one before it."""

WALL = 90
"""The occupancy of a known wall before any scan."""


class Mapper(Component):
    """An occupancy grid: each beam empties the cells it crosses and fills its last."""

    maps: Provided[Maps]

    def configure(self) -> None:
        walls = np.where(grid.walls(), np.int8(WALL), np.int8(0))
        self._map = Map(self.clock.stamp(), walls)
        self._steps = np.arange(0, MAX_RANGE, grid.CELL)

    def latest_map(self) -> Map:
        return self._map

    @subscribed(keep=1)
    def located(self, message: LocatedScan) -> None:
        self._map = Map(message.pose.stamp, self._updated(message))

    def snapshot(self) -> Map:
        return self._map

    def restore(self, state: Map) -> None:
        self._map = state

    def _updated(self, message: LocatedScan) -> grid.Cells:
        """Return the map with one more scan in it."""
        ranges = message.ranges.astype(float)
        change = np.zeros((grid.SIZE, grid.SIZE), np.int16)
        # A cell that one beam hits and another passes counts as hit.
        beams, steps = np.nonzero(self._steps < ranges[:, None] - 1.5 * grid.CELL)
        change[self._cells(message, beams, self._steps[steps])] = MISS
        hits = np.nonzero(ranges < MAX_RANGE - 0.05)[0]
        change[self._cells(message, hits, ranges[hits])] = HIT
        occupancy = np.clip(self._map.cells + change, -100, 100)
        return np.asarray(occupancy, np.int8)

    def _cells(
        self, message: LocatedScan, beams: grid.Indices, lengths: grid.Floats
    ) -> tuple[grid.Indices, grid.Indices]:
        """Return rows and columns of the points `lengths` [m] along `beams`."""
        pose = message.pose
        directions = (pose.heading + ANGLES)[beams]
        x = pose.x + lengths * np.cos(directions)
        y = pose.y + lengths * np.sin(directions)
        return grid.row(y), grid.column(x)


def occupied(cells: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return which cells of a map are obstacles."""
    return np.asarray(cells >= grid.OCCUPIED)
