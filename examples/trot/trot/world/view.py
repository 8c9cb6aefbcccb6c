"""What the head's camera has in view, and whether the robot names who that is."""

from __future__ import annotations

import math
from typing import Any

from trot.household import PEOPLE
from trot.packets import pack_view
from trot.world import sound
from trot.world.eye import Eye
from trot.world.simulation import Simulation

SIDE = 0.4
"""[rad] Who is further aside is not in view as a whole."""

FAR = 3.0
"""[m] Nobody need be recognised who is further away."""

TIME = 1.0
"""[s] The robot may take this long to name somebody."""


class View:
    """One person of the household, whom the seed chooses."""

    def __init__(self, seed: int = 0) -> None:
        self.name = list(PEOPLE)[seed % len(PEOPLE)]
        self._eye = Eye(self.name, seed)
        self._since = math.inf
        self._judged: list[bool] = []

    def picture(
        self, now: float, simulation: Simulation, head: float, person: sound.Place
    ) -> bytes:
        """Return the camera's packet, with the head at `head` [rad] from ahead."""
        angle = math.remainder(
            sound.bearing(simulation.pose, person) - head, 2 * math.pi
        )
        distance = math.dist(simulation.pose[:2], person)
        ahead = abs(angle) < math.pi / 3 and simulation.sees(*person)
        if not (ahead and abs(angle) < SIDE and distance < FAR):
            self._since = math.inf
        elif self._since == math.inf:
            self._since = now
        return pack_view(now, head, self._eye.jpeg(angle, distance if ahead else None))

    def judge(self, now: float, shown: str) -> None:
        """Take notice of the name that the screen shows `now` [s]."""
        if now - self._since > TIME:
            self._judged.append(shown == self.name)

    def result(self) -> dict[str, Any]:
        """Return how often who was in view was named rightly."""
        share = sum(self._judged) / len(self._judged) if self._judged else None
        return {"named": None if share is None else round(share, 3)}
