"""What T-Rot's components say to each other. Stamps are the clock's [s]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from poise import Message, Stamp


class Pose(Message, frozen=True):
    """Where the robot was at `stamp`: x, y [m], heading [rad]."""

    stamp: Stamp
    x: float
    y: float
    heading: float


class Scan(Message, frozen=True):
    """Ranges [m] of the laser's beams, and what the wheels had counted by then."""

    stamp: Stamp
    ranges: NDArray[np.float32]
    odometry: Pose


class LocatedScan(Message, frozen=True):
    """Ranges [m] of the laser's beams, and from where they were measured."""

    pose: Pose
    ranges: NDArray[np.float32]


class Map(Message, frozen=True):
    """Occupancy of each cell of the grid (`trot.navigator.grid`), ``(SIZE, SIZE)``.

    -100 is surely free, 0 unknown, 100 surely occupied.
    """

    stamp: Stamp
    cells: NDArray[np.int8]


class Path(Message, frozen=True):
    """Points x, y [m] from the robot to the goal, ``(n, 2)``; none: no way found."""

    stamp: Stamp
    points: NDArray[np.float32]


class AudioBlock(Message, frozen=True):
    """Samples of each microphone, ``(MICROPHONES, SOUND_SAMPLES)``."""

    stamp: float
    samples: NDArray[np.int16]


class Bearing(Message, frozen=True):
    """A sound came from `angle` [rad], counter-clockwise from ahead."""

    stamp: float
    angle: float


class Source(Message, frozen=True):
    """Somebody speaks at x, y [m] of the flat, known to about `spread` [m]."""

    stamp: float
    x: float
    y: float
    spread: float


class Seen(Message, frozen=True):
    """Who is in view: `bearing` [rad] from the robot's ahead, `distance` [m]."""

    stamp: float
    name: str
    bearing: float
    distance: float


class Attention(Message, frozen=True):
    """Where the robot looks [rad], counter-clockwise from ahead."""

    stamp: float
    bearing: float


class Speech(Message, frozen=True):
    """Samples of somebody who speaks, ``(n,)``, and whether the sentence ends."""

    stamp: float
    samples: NDArray[np.int16]
    ends: bool


class Caption(Message, frozen=True):
    """What somebody has said so far, as it sounds."""

    stamp: float
    text: str


class Utterance(Message, frozen=True):
    """A command that somebody gave."""

    stamp: float
    text: str


class Sentence(Message, frozen=True):
    """What the robot is to say, and to which words."""

    stamp: float
    text: str
    heard: str


class Order(Message, frozen=True):
    """The cup is to be put on this side of the tray: ``left`` or ``right``."""

    stamp: float
    side: str


class Mouth(Message, frozen=True):
    """How loud the robot speaks, in [0, 1]."""

    stamp: float
    loudness: float


class Image(Message, frozen=True):
    """Pixels, ``(height, width, 3)``."""

    stamp: float
    pixels: NDArray[np.uint8]


class Cup(Message, frozen=True):
    """Where the cup is seen: x, y [m] in the robot's frame."""

    stamp: float
    x: float
    y: float


class Reach(Message, frozen=True):
    """Angles of the joints [rad] to go to, ``(6,)``, and what the hand does there.

    The arm `carries` the cup on the way, and the hand `closes` or opens at the end.
    """

    stamp: float
    number: int
    angles: NDArray[np.float32]
    carries: bool
    closes: bool


class Trajectory(Message, frozen=True):
    """Angles of the joints [rad] every 20 ms, ``(steps, 6)``, for a reach."""

    stamp: float
    number: int
    angles: NDArray[np.float32]
    closes: bool


class Joints(Message, frozen=True):
    """Angles of the arm's joints [rad], ``(6,)``, and which reach is done."""

    stamp: float
    angles: NDArray[np.float32]
    done: int


class Programme(Message, frozen=True):
    """A programme on the air in a slot; `genres` are eight shares (float64)."""

    number: int
    title: str
    genres: bytes
    slot: int


class Watched(Message, frozen=True):
    """Who watched what: viewer and programme, ``(n, 2)``."""

    stamp: float
    pairs: NDArray[np.int32]


class Wish(Message, frozen=True):
    """Somebody would like to know what is on television."""

    stamp: float
