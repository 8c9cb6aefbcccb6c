"""The robot's base, its laser and its home, in simulated time.

Pymunk (Chipmunk 2-D) does the contacts and the rays in C. It is one small package, and
270 rays ten times a second take a few percent of a core. Simulators made for robots
(ir-sim, for one) also draw, and bring matplotlib and shapely along for that.
"""

from __future__ import annotations

import math

import numpy as np
import pymunk
from numpy.typing import NDArray

from trot import home
from trot.laser_model import ANGLES, BEAMS, MAX_RANGE, NOISE
from trot.packets import Odometry

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

_ROBOT, _OBSTACLE = 1, 2
_SEES = pymunk.ShapeFilter(mask=pymunk.ShapeFilter.ALL_MASKS() ^ 1)


class Simulation:
    """A base with two wheels and a bumper in a home.

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
        self._space = pymunk.Space()
        self._build(walls, furniture)
        self._body = self._robot(start)
        self._space.on_collision(_ROBOT, _OBSTACLE, begin=self._bump)
        self._wanted = (0.0, 0.0)
        self._commanded_at = -math.inf
        self._bumped_at = -math.inf
        self._speed = self._turn = 0.0
        self._odometry = list(start)
        self.now = 0.0
        self.collisions = 0
        self.path_length = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the robot truly is: x [m], y [m], heading [rad]."""
        x, y = self._body.position
        return x, y, self._body.angle

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
        before = self._body.position
        heading = self._body.angle
        self._body.velocity = (
            self._speed * math.cos(heading),
            self._speed * math.sin(heading),
        )
        self._body.angular_velocity = self._turn
        self._space.step(STEP)
        self.path_length += before.get_distance(self._body.position)
        self.now += STEP

    def scan(self) -> NDArray[np.float32]:
        """Return the range of each beam [m], ``(BEAMS,)``, with noise."""
        x, y, heading = self.pose
        ends = np.stack(
            [
                x + MAX_RANGE * np.cos(heading + ANGLES),
                y + MAX_RANGE * np.sin(heading + ANGLES),
            ],
            axis=1,
        ).tolist()
        ranges = np.fromiter((self._ray((x, y), e) for e in ends), float, BEAMS)
        noisy = ranges + self._random.normal(0, NOISE, BEAMS)
        return np.clip(noisy, 0, MAX_RANGE).astype(np.float32)

    def _ray(self, start: tuple[float, float], end: tuple[float, float]) -> float:
        hit = self._space.segment_query_first(start, end, 0.0, _SEES)
        return MAX_RANGE if hit is None else hit.alpha * MAX_RANGE

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

    def _bump(self, *_: object) -> None:
        self.collisions += 1
        self._bumped_at = self.now

    def _build(
        self, walls: tuple[home.Segment, ...], furniture: tuple[home.Box, ...]
    ) -> None:
        ground = self._space.static_body
        shapes: list[pymunk.Shape] = [
            pymunk.Segment(ground, (ax, ay), (bx, by), home.WALL_RADIUS)
            for ax, ay, bx, by in walls
        ]
        shapes += [
            pymunk.Poly(ground, [(a, b), (c, b), (c, d), (a, d)])
            for a, b, c, d in furniture
        ]
        for shape in shapes:
            shape.collision_type = _OBSTACLE
            shape.filter = pymunk.ShapeFilter(categories=2)
            self._space.add(shape)

    def _robot(self, start: tuple[float, float, float]) -> pymunk.Body:
        body = pymunk.Body(mass=50.0, moment=math.inf)
        body.position = start[:2]
        body.angle = start[2]
        circle = pymunk.Circle(body, home.ROBOT_RADIUS)
        circle.collision_type = _ROBOT
        circle.filter = pymunk.ShapeFilter(categories=1)
        self._space.add(body, circle)
        return body


def _toward(value: float, target: float, most: float) -> float:
    return value + min(most, max(-most, target - value))
