"""The robot, its home and its cup, in simulated time; MuJoCo does the physics."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from trot import home
from trot.laser_model import ANGLES, BEAMS, MAX_RANGE, NOISE
from trot.packets import Odometry
from trot.world import flat
from trot.world.hand import Hand

STEP = 0.02
"""[s] of simulated time per step."""

COMMAND_LIFE = 0.5
"""[s] The wheels stop when no command came for this long, as a real base's do."""

BUMPER_HOLD = 1.0
"""[s] The wheels stand still after the bumper was hit."""

MAX_SPEED = 1.0
"""[m/s]"""

MAX_TURN = 2.0
"""[rad/s]"""

ACCELERATION = 1.2
"""[m/s2]"""

TURN_ACCELERATION = 4.0
"""[rad/s2]"""

_SEEN = np.array([1, 0, 0, 0, 0, 0], np.uint8)
_PHYSICS_STEPS = round(STEP / flat.STEP)


class Simulation:
    """A base with two wheels and a bumper in a home, and an arm on top of it.

    Parameters
    ----------
    seed
        Of the noise in odometry and laser.
    start
        x [m], y [m], heading [rad].
    walls, furniture
        As in `trot.home`.
    """

    def __init__(
        self,
        seed: int = 0,
        *,
        start: tuple[float, float, float] = home.START,
        walls: tuple[home.Segment, ...] = home.WALLS,
        furniture: tuple[home.Box, ...] = home.FURNITURE,
    ) -> None:
        self._random = np.random.default_rng(seed)
        model = mujoco.MjModel.from_xml_string(flat.flat(walls, furniture))
        self._model, self._data = model, mujoco.MjData(model)
        self._hull, self._robot = model.geom("hull").id, model.body("robot").id
        self._data.qpos[:3] = start
        self.hand = Hand(model, self._data)
        mujoco.mj_forward(model, self._data)
        self._wanted = (0.0, 0.0)
        self._commanded_at = -math.inf
        self._bumped_at = -math.inf
        self._touches = False
        self._speed = self._turn = 0.0
        self._odometry = list(start)
        self.now = 0.0
        self.collisions = 0
        self.path_length = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the robot truly is: x [m], y [m], heading [rad]."""
        x, y, heading = self._data.qpos[:3]
        return float(x), float(y), float(heading)

    @property
    def odometry(self) -> Odometry:
        """Simulated time [s] and where the wheels have counted the robot to."""
        x, y, heading = self._odometry
        return self.now, x, y, heading

    @property
    def distance_to_goal(self) -> float:
        """How far the robot is from its goal [m]."""
        return math.dist(self.pose[:2], home.GOAL)

    @property
    def goal_reached(self) -> bool:
        """Whether the robot's centre is within `home.GOAL_RADIUS` of the goal."""
        return self.distance_to_goal <= home.GOAL_RADIUS

    def command(self, speed: float, turn: float) -> None:
        """Ask for a forward speed [m/s] and a turn rate [rad/s], for half a second."""
        self._wanted = (
            min(MAX_SPEED, max(-MAX_SPEED, speed)),
            min(MAX_TURN, max(-MAX_TURN, turn)),
        )
        self._commanded_at = self.now

    def step(self) -> None:
        """Let `STEP` of simulated time pass."""
        self._turn_wheels()
        self._count_wheels()
        before = self.pose
        for _ in range(_PHYSICS_STEPS):
            heading = self._data.qpos[2]
            self._data.qvel[:3] = (
                self._speed * math.cos(heading),
                self._speed * math.sin(heading),
                self._turn,
            )
            mujoco.mj_step(self._model, self._data)
            self._feel()
        self.hand.follow(STEP)
        self.path_length += math.dist(before[:2], self.pose[:2])
        self.now += STEP

    def scan(self) -> NDArray[np.float32]:
        """Return the range of each beam [m], ``(BEAMS,)``, with noise."""
        x, y, heading = self.pose
        directions = heading + ANGLES
        rays = np.stack(
            [np.cos(directions), np.sin(directions), np.zeros(BEAMS)], axis=1
        )
        ranges = np.zeros(BEAMS)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            np.array([x, y, flat.LASER_HEIGHT]),
            rays.reshape(-1),
            _SEEN,
            True,
            self._robot,
            np.zeros(BEAMS, np.int32),
            ranges,
            None,
            BEAMS,
            MAX_RANGE,
        )
        ranges[ranges < 0] = MAX_RANGE
        noisy = ranges + self._random.normal(0, NOISE, BEAMS)
        return np.clip(noisy, 0, MAX_RANGE).astype(np.float32)

    def sees(self, x: float, y: float) -> bool:
        """Return whether no wall is between the robot's eyes and a place [m]."""
        ahead = np.array([x - self.pose[0], y - self.pose[1], 0.0])
        length = float(np.linalg.norm(ahead))
        eyes = np.array([*self.pose[:2], flat.EYE_HEIGHT])
        hit = np.zeros(1, np.int32)
        wall = mujoco.mj_ray(
            self._model, self._data, eyes, ahead / length, _SEEN, True, -1, hit
        )
        return bool(wall < 0 or wall > length)

    def _turn_wheels(self) -> None:
        """Bring the speeds nearer to what was asked for."""
        alive = self.now - self._commanded_at < COMMAND_LIFE
        speed, turn = self._wanted if alive else (0.0, 0.0)
        if self.now - self._bumped_at < BUMPER_HOLD:
            self._speed = self._turn = speed = turn = 0.0
        self._speed = _toward(self._speed, speed, ACCELERATION * STEP)
        self._turn = _toward(self._turn, turn, TURN_ACCELERATION * STEP)

    def _count_wheels(self) -> None:
        """Add what the wheels turned, 1 % too much and noisy, to the odometry."""
        noise = self._random.normal(0, 0.05, 2)
        length = self._speed * STEP * (1.01 + noise[0])
        angle = self._turn * STEP * (1.01 + noise[1])
        x, y, heading = self._odometry
        middle = heading + angle / 2
        self._odometry = [
            x + length * math.cos(middle),
            y + length * math.sin(middle),
            heading + angle,
        ]

    def _feel(self) -> None:
        """Stop the wheels when the hull begins to touch anything."""
        contact, count = self._data.contact, self._data.ncon
        touches = bool(
            np.any(contact.geom1[:count] == self._hull)
            or np.any(contact.geom2[:count] == self._hull)
        )
        if touches and not self._touches:
            self.collisions += 1
            self._bumped_at = self.now
            self._speed = self._turn = 0.0
        self._touches = touches


def _toward(value: float, target: float, most: float) -> float:
    return value + min(most, max(-most, target - value))
