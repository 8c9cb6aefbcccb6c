"""What camera and scanner see of the scene, with noise."""

from __future__ import annotations

import cv2
import numpy as np

from sorter import cell
from sorter.lamps import lit
from sorter.world.scene import Scene, Thing

PAINT = {"red": (50, 50, 215), "green": (60, 185, 60), "blue": (215, 120, 40)}
BELT, SCRATCH = (62, 62, 62), (35, 35, 35)
NOISE, QUALITY = 5.0, 90

ROOM = 5.0
"""[m] from the scanner to the walls."""


class Sensors:
    """The lamps' colour and all noise come from the seed."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._lamps = self._random.uniform(0.8, 1.15, 3)
        shape = (cell.HEIGHT, cell.WIDTH, 3)
        # Of a few patterns one is taken at random: new noise for each is slow.
        self._noise = [
            self._random.normal(0, NOISE, shape).astype(np.int16) for _ in range(4)
        ]

    def picture(self, scene: Scene) -> bytes:
        """Return what the camera over the belt sees, as JPEG."""
        pixels = np.full((cell.HEIGHT, cell.WIDTH, 3), BELT, np.uint8)
        for thing in scene.things:
            if not thing.fate and thing is not scene.held:
                _draw(pixels, thing)
        noise = self._noise[int(self._random.integers(len(self._noise)))]
        bright = lit(pixels, self._lamps)
        noisy = cv2.add(bright, noise, dtype=cv2.CV_8U)
        _, coded = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return bytes(coded)

    def ranges(self, scene: Scene) -> bytes:
        """Return the ranges [m] of the scanner's beams over half a turn, float32."""
        scan = np.full(cell.BEAMS, ROOM)
        if scene.person < ROOM:
            half = np.degrees(np.arctan2(0.25, scene.person)) * cell.BEAMS / 180
            middle = cell.BEAMS // 2
            scan[int(middle - half) : int(middle + half) + 1] = scene.person
        scan += self._random.normal(0, 0.02, cell.BEAMS)
        return scan.astype(np.float32).tobytes()


def _draw(pixels: np.ndarray, thing: Thing) -> None:
    middle, size = cell.pixel(thing.x, thing.y), round(cell.OBJECT / cell.PIXEL)
    paint = PAINT[thing.colour]
    if thing.round:
        cv2.circle(pixels, middle, size, paint, -1, cv2.LINE_AA)
    else:
        square = (middle, (1.8 * size, 1.8 * size), float(np.degrees(thing.angle)))
        corners = cv2.boxPoints(square).round().astype(np.int32)
        cv2.fillPoly(pixels, [corners], paint, cv2.LINE_AA)
    if thing.scratch is not None:
        along = 0.6 * size * np.array([np.cos(thing.scratch), np.sin(thing.scratch)])
        ends = [
            tuple(np.round(middle + way).astype(int).tolist())
            for way in (along, -along)
        ]
        cv2.line(pixels, ends[0], ends[1], SCRATCH, 3, cv2.LINE_AA)
