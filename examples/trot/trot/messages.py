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
    """A sound came from `angle` [rad]; `strength` in [0, 1]."""

    stamp: float
    angle: float
    strength: float


class Activity(Message, frozen=True):
    """How probably somebody spoke, in [0, 1]."""

    stamp: float
    probability: float


class Speech(Message, frozen=True):
    """Log energies of speech by time and band, ``(frames, bands)``."""

    stamp: float
    features: NDArray[np.float32]


class Attention(Message, frozen=True):
    """Where to look [rad], and how much that matters, in [0, 1]."""

    stamp: float
    bearing: float
    urgency: float


class Utterance(Message, frozen=True):
    """What somebody said, as an intent and how sure that is, in [0, 1]."""

    stamp: float
    intent: str
    confidence: float


class Sentence(Message, frozen=True):
    """What the robot is to say."""

    stamp: float
    text: str


class Emotion(Message, frozen=True):
    """The robot's mood: pleasant or not, and lively or not, each in [-1, 1]."""

    stamp: float
    valence: float
    arousal: float


class Gesture(Message, frozen=True):
    """A point [m] that the hand is to reach, in the frame of the shoulder."""

    stamp: float
    x: float
    y: float
    z: float


class Image(Message, frozen=True):
    """Pixels, ``(height, width, 3)``."""

    stamp: float
    pixels: NDArray[np.uint8]


class Joints(Message, frozen=True):
    """Angles of the arm's joints [rad], ``(6,)``."""

    stamp: float
    angles: NDArray[np.float32]


class Trajectory(Message, frozen=True):
    """Angles of the joints [rad] at equal steps of 20 ms, ``(steps, 6)``."""

    stamp: float
    angles: NDArray[np.float32]


class Programme(Message, frozen=True):
    """A programme in the television guide; `number` names it."""

    number: int
    title: str
    genre: int
    start: float


class Wish(Message, frozen=True):
    """The viewer would like to see something of this genre."""

    stamp: float
    genre: int
