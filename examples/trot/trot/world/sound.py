"""What the microphones hear: a person who speaks in a room with echoes.

The flat is one room for sound: what is said in one room is heard in all. The robot's
own voice is not heard, as with a robot that cancels its echo.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trot.array import MICROPHONES_AT
from trot.packets import MICROPHONES, SAMPLE_RATE, SOUND_SAMPLES

PERSON = (4.7, 2.1)
"""x and y [m] of the person's chair, beside the sofa."""

Place = tuple[float, float]
"""x and y [m]."""

ROOM = (8.0, 6.0, 2.6)
MOUTH, EARS = 1.2, 0.6
"""[m] above the floor: the person's mouth, the robot's microphones."""

ABSORPTION = 0.5
"""The share of the sound's energy that walls take: a furnished room."""

ECHOES = 3
"""How often a sound is reflected at most."""

NOISE = 30
"""Standard deviation of the microphones' noise; people's voices reach 10,000."""

_TAIL = 2400
"""Samples until the last echo is over."""

_MIRROR = math.sqrt(1 - ABSORPTION)
_ORDERS = np.array(
    [
        order
        for order in product(range(-ECHOES, ECHOES + 1), repeat=3)
        if sum(map(abs, order)) <= ECHOES
    ]
)
"""How often each image was mirrored along x, y and z, ``(n, 3)``."""

_LOUD = 8.0
"""People speak up, to be heard by a robot."""

SPEED_OF_SOUND = 343.0
"""[m/s]"""

Pose = tuple[float, float, float]


class Sound:
    """Blocks of sound ``(MICROPHONES, SOUND_SAMPLES)``, one after the other."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng(seed)
        self._rest = np.zeros((MICROPHONES, _TAIL))
        self._left: NDArray[np.int16] = np.zeros(0, np.int16)

    @property
    def is_speaking(self) -> bool:
        """Whether the person has not ended a sentence."""
        return len(self._left) > 0

    def say(self, samples: NDArray[np.int16]) -> None:
        """Let the person say this from now on."""
        self._left = samples

    def block(self, robot: Pose, person: Place = PERSON) -> NDArray[np.int16]:
        """Return what the microphones hear next, where robot and person are now."""
        heard = self._random.normal(0, NOISE, (MICROPHONES, SOUND_SAMPLES))
        total = np.zeros((MICROPHONES, SOUND_SAMPLES + _TAIL))
        total[:, :_TAIL] = self._rest
        if self.is_speaking:
            said, self._left = self._left[:SOUND_SAMPLES], self._left[SOUND_SAMPLES:]
            total += _echoed(said, robot, person)
        self._rest = total[:, SOUND_SAMPLES:]
        heard += total[:, :SOUND_SAMPLES]
        return np.clip(heard, -32768, 32767).astype(np.int16)


def bearing(robot: Pose, person: Place = PERSON) -> float:
    """Return where the person is [rad], counter-clockwise from ahead of the robot."""
    angle = math.atan2(person[1] - robot[1], person[0] - robot[0]) - robot[2]
    return math.remainder(angle, 2 * math.pi)


def _echoed(said: NDArray[np.int16], robot: Pose, person: Place) -> NDArray[np.float64]:
    """Return a block as each microphone hears it, and its echoes after it."""
    length = SOUND_SAMPLES + _TAIL
    ways = np.fft.rfft(responses(robot, person), 2 * length)
    heard = np.fft.irfft(np.fft.rfft(said, 2 * length) * ways, 2 * length)
    return np.asarray(heard[:, :length])


def responses(robot: Pose, person: Place = PERSON) -> NDArray[np.float64]:
    """Return what each microphone hears of a clap, ``(MICROPHONES, samples)``.

    The image sources of Allen and Berkley (1979): an echo comes from where the person
    is seen in the walls as in mirrors.
    """
    x, y, heading = robot
    cosine, sine = math.cos(heading), math.sin(heading)
    ahead, left = MICROPHONES_AT
    across, along = cosine * ahead - sine * left, sine * ahead + cosine * left
    ears = np.stack([x + across, y + along, np.full(MICROPHONES, EARS)], axis=1)
    mouth = np.array([*person, MOUTH])
    images = np.where(_ORDERS % 2, ROOM - mouth, mouth) + _ORDERS * ROOM
    lengths = np.linalg.norm(ears[:, None] - images, axis=2)
    gains = _LOUD * _MIRROR ** np.abs(_ORDERS).sum(axis=1) / (4 * math.pi * lengths)
    samples = lengths / SPEED_OF_SOUND * SAMPLE_RATE
    first = samples.astype(np.intp)
    late = samples - first
    result = np.zeros((MICROPHONES, _TAIL))
    rows = np.arange(MICROPHONES)[:, None]
    np.add.at(result, (rows, first), gains * (1 - late))
    np.add.at(result, (rows, first + 1), gains * late)
    return result
