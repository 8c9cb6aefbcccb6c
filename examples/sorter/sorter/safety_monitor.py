"""Looks for people by a laser scanner, and says whether the arm may move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Component, Published, every
from sorter import cell
from sorter.device import Device
from sorter.messages import Guard

WALKS, REACTION = 1.6, 0.4
"""How fast people walk [m/s], as ISO 13855 has it, and the time until the arm stands
[s]."""

STOP_AT = cell.PERSON_TOO_NEAR + WALKS * REACTION
"""[m]"""

BEHIND, BEAMS = 0.3, 4
"""So much [m] before the background, and so many beams wide, is a person."""


class SafetyMonitor(Component):
    """Publishes its judgement of every scan; none, and the arm stops."""

    guard: Published[Guard]

    def configure(self) -> None:
        self._scanner = Device(self.device("scanner"))
        self._background = np.zeros(cell.BEAMS)

    @every(cell.SCANNER_PERIOD, deadline=cell.SCANNER_PERIOD)
    def look(self) -> None:
        if (packet := self._scanner.newest()) is None:
            return
        at, ranges = packet
        scan = np.frombuffer(ranges, np.float32).astype(float)
        self._background = np.maximum(self._background, scan)
        clear = nearest(scan, self._background) > STOP_AT
        self.guard.publish(Guard(self.clock.stamp(at), bool(clear)))

    def cleanup(self) -> None:
        self._scanner.close()


def nearest(scan: NDArray[np.float64], background: NDArray[np.float64]) -> float:
    """Return how near a person is [m]; infinite when there is none."""
    before = scan < background - BEHIND
    edges = np.flatnonzero(np.diff(np.concatenate([[0], before.astype(int), [0]])))
    persons = [
        float(np.median(scan[begin:end]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
        if end - begin >= BEAMS
    ]
    return min(persons, default=np.inf)
