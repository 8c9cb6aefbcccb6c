"""The grid of the map: 10 m x 10 m around the home, in cells of 5 cm.

An array on the grid is indexed ``[row, column]``: the row counts y, the column x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trot import home

SIZE = 200
CELL = 0.05
"""[m]"""

ORIGIN = (-1.0, -2.0)
"""x and y [m] of the lower left corner."""

OCCUPIED = 25
"""A cell of the map is an obstacle from this occupancy on."""

Cells = NDArray[np.int8]
Floats = NDArray[np.float64]
Distances = NDArray[np.float32]
Indices = NDArray[np.intp]


def column(x: Floats) -> Indices:
    """Return the columns of x [m]; those outside are taken to the edge."""
    return _clipped((x - ORIGIN[0]) / CELL)


def row(y: Floats) -> Indices:
    """Return the rows of y [m]; those outside are taken to the edge."""
    return _clipped((y - ORIGIN[1]) / CELL)


def _clipped(cells: Floats) -> Indices:
    return np.clip(cells, 0, SIZE - 1).astype(np.intp)


def walls(segments: tuple[home.Segment, ...] = home.WALLS) -> NDArray[np.bool_]:
    """Return which cells the walls cover, ``(SIZE, SIZE)``."""
    covered = np.zeros((SIZE, SIZE), bool)
    for ax, ay, bx, by in segments:
        steps = int(max(abs(bx - ax), abs(by - ay)) / CELL * 2) + 2
        x, y = np.linspace(ax, bx, steps), np.linspace(ay, by, steps)
        # Just within the wall, so that its edge does not claim one more cell.
        inside = home.WALL_RADIUS - 1e-6
        for across, up in ((inside, inside), (-inside, -inside)):
            covered[row(y + up), column(x + across)] = True
    return covered


def distance(occupied: NDArray[np.bool_], limit: float, cell: float) -> Distances:
    """Return how far [m] each cell is from the nearest occupied one, `limit` at most.

    Parameters
    ----------
    occupied
        ``(rows, columns)``
    limit
        [m]; the work grows with it.
    cell
        The length of a cell [m].
    """
    field = np.where(occupied, np.float32(0), np.float32(limit))
    padded = np.full((field.shape[0] + 2, field.shape[1] + 2), limit, np.float32)
    for _ in range(int(limit / cell) + 1):
        padded[1:-1, 1:-1] = field
        for down, right in NEIGHBOURS:
            step = np.float32(cell * np.hypot(down, right))
            np.minimum(field, shifted(padded, down, right) + step, out=field)
    return field


NEIGHBOURS = [(d, r) for d in (-1, 0, 1) for r in (-1, 0, 1) if (d, r) != (0, 0)]


def shifted(padded: Distances, down: int, right: int) -> Distances:
    """Return what lies `down` rows and `right` columns from each inner cell."""
    rows, columns = padded.shape
    return padded[1 + down : rows - 1 + down, 1 + right : columns - 1 + right]
