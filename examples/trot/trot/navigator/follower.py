"""Where to drive in order to follow a person."""

from __future__ import annotations

import math

from trot.messages import Pose, Seen

BEHIND = 0.9
"""[m] Who follows keeps this far away."""

NEAR = 1.4
"""[m] Who follows is there when a person stands this near."""

LOST = 1.5
"""[s] Who was not seen for so long is looked for where it was."""

LED, MOVES, STANDS = 1.0, 0.25, 3.0
"""[m] Who went this far has led; who moves less than this [m] so long [s] stands."""

Place = tuple[float, float]


class Follower:
    """Knows where the person was seen last [m], and where that began."""

    def __init__(self) -> None:
        self._first: Place | None = None
        self._person: Place | None = None
        self._stood = (math.inf, math.inf)
        self._since = self._seen = math.inf
        self._behind: Place | None = None

    def goal(self, now: float) -> Place | None:
        """Return where to drive `now` [s]; None while nobody has been seen."""
        return self._person if now - self._seen > LOST else self._behind

    def note(self, pose: Pose, seen: Seen) -> None:
        """Note where somebody is seen from `pose`."""
        angle = pose.heading + seen.bearing
        away = seen.distance
        person = pose.x + away * math.cos(angle), pose.y + away * math.sin(angle)
        self._first = self._first or person
        self._person, self._seen = person, seen.stamp
        if math.dist(person, self._stood) > MOVES:
            self._stood, self._since = person, seen.stamp
        share = max(0.0, away - BEHIND) / max(away, 1e-6)
        self._behind = (
            pose.x + share * (person[0] - pose.x),
            pose.y + share * (person[1] - pose.y),
        )

    def is_there(self, pose: Pose, now: float) -> bool:
        """Whether the person has led, stands by `now` [s], and is near."""
        if self._person is None or self._first is None:
            return False
        has_led = math.dist(self._person, self._first) > LED
        is_near = math.dist(self._person, (pose.x, pose.y)) < NEAR
        return has_led and is_near and now - self._since > STANDS
