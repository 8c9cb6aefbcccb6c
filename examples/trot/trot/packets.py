"""The packets that cross a device's socket: fixed little-endian records.

====================  =============================================================
``wheels.sock``       to the robot 50 times a second: time, x, y, heading as the wheels
                      have counted them; from the robot: forward speed [m/s], turn rate
                      [rad/s]
``laser.sock``        10 times a second: time, then one range [m] for each beam
``microphones.sock``  20 times a second: time, then one row of samples a microphone
``speakers.sock``     from the robot: samples
``screen.sock``       from the robot: what is on the screen
``arm.sock``          to the robot 50 times a second: angles [rad] of six joints, and
                      whether the hand is closed; from the robot: the same, wanted
``cameras.sock``      to the robot 20 times a second: time, then a JPEG picture
``eyes.sock``         5 times a second: time, where the head looks [rad], then a JPEG
                      picture of what it sees
``pan_tilt.sock``     from the robot: where the head is to look [rad]
``television.sock``   to the robot 10 times a second: viewers and what they watch
``remote_control.sock``  from the robot: what it recommends
====================  =============================================================

Times are CLOCK_MONOTONIC [s], which all emulated computers share.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

DEVICES = (
    *("wheels", "laser", "arm", "cameras", "eyes", "pan_tilt"),
    *("microphones", "speakers", "screen", "television", "remote_control"),
)
"""Their names in the robot file, and of their sockets."""

MICROPHONES = 4
SAMPLE_RATE = 16_000
"""[1/s]"""

SOUND_PERIOD = 0.05
"""[s] The length of a block of sound."""

SOUND_SAMPLES = round(SAMPLE_RATE * SOUND_PERIOD)

_ODOMETRY = struct.Struct("<4d")
_COMMAND = struct.Struct("<2d")
_STAMP = struct.Struct("<d")

Odometry = tuple[float, float, float, float]
"""Time [s], x [m], y [m], heading [rad]."""


def pack_odometry(odometry: Odometry) -> bytes:
    return _ODOMETRY.pack(*odometry)


def unpack_odometry(packet: bytes) -> Odometry:
    stamp, x, y, heading = _ODOMETRY.unpack(packet)
    return stamp, x, y, heading


def pack_command(speed: float, turn: float) -> bytes:
    return _COMMAND.pack(speed, turn)


def unpack_command(packet: bytes) -> tuple[float, float] | None:
    """Return speed [m/s] and turn rate [rad/s]; None for what is no command."""
    if len(packet) != _COMMAND.size:
        return None
    speed, turn = _COMMAND.unpack(packet)
    return (speed, turn) if np.isfinite([speed, turn]).all() else None


def pack_ranges(stamp: float, ranges: NDArray[np.float32]) -> bytes:
    return _STAMP.pack(stamp) + ranges.astype("<f4").tobytes()


def unpack_ranges(packet: bytes) -> tuple[float, NDArray[np.float32]]:
    (stamp,) = _STAMP.unpack_from(packet)
    return stamp, np.frombuffer(packet, "<f4", offset=_STAMP.size)


def pack_sound(stamp: float, samples: NDArray[np.int16]) -> bytes:
    return _STAMP.pack(stamp) + samples.astype("<i2").tobytes()


def unpack_sound(packet: bytes) -> tuple[float, NDArray[np.int16]]:
    """Return the time [s] and the samples ``(MICROPHONES, SOUND_SAMPLES)``."""
    (stamp,) = _STAMP.unpack_from(packet)
    samples = np.frombuffer(packet, "<i2", offset=_STAMP.size)
    return stamp, samples.reshape(MICROPHONES, -1)


_ARM = struct.Struct("<6d?")
_ANGLE = struct.Struct("<d")
_SCREEN = struct.Struct("<dHHH")
_VIEW = struct.Struct("<2d")
_SLOT = struct.Struct("<dq")


class Screen(NamedTuple):
    """When the robot said something [s], to what words, what; whom it sees; a JPEG."""

    stamp: float
    heard: str
    said: str
    seen: str
    picture: bytes


def pack_arm(angles: NDArray[np.floating], *, closed: bool) -> bytes:
    return _ARM.pack(*map(float, angles), closed)


def unpack_arm(packet: bytes) -> tuple[NDArray[np.float64], bool]:
    *angles, closed = _ARM.unpack(packet)
    return np.array(angles), closed


def pack_angle(angle: float) -> bytes:
    return _ANGLE.pack(angle)


def unpack_angle(packet: bytes) -> float:
    (angle,) = _ANGLE.unpack(packet)
    return float(angle)


def pack_picture(stamp: float, picture: bytes) -> bytes:
    return _STAMP.pack(stamp) + picture


def unpack_picture(packet: bytes) -> tuple[float, bytes]:
    (stamp,) = _STAMP.unpack_from(packet)
    return stamp, packet[_STAMP.size :]


def pack_view(stamp: float, head: float, picture: bytes) -> bytes:
    return _VIEW.pack(stamp, head) + picture


def unpack_view(packet: bytes) -> tuple[float, float, bytes]:
    stamp, head = _VIEW.unpack_from(packet)
    return stamp, head, packet[_VIEW.size :]


def pack_screen(screen: Screen) -> bytes:
    texts = [each.encode() for each in (screen.heard, screen.said, screen.seen)]
    head = _SCREEN.pack(screen.stamp, *map(len, texts))
    return head + b"".join(texts) + screen.picture


def unpack_screen(packet: bytes) -> Screen:
    stamp, *lengths = _SCREEN.unpack_from(packet)
    texts, rest = [], packet[_SCREEN.size :]
    for length in lengths:
        texts.append(rest[:length].decode())
        rest = rest[length:]
    heard, said, seen = texts
    return Screen(stamp, heard, said, seen, rest)


def pack_watched(pairs: NDArray[np.int32]) -> bytes:
    return pairs.astype("<i4").tobytes()


def unpack_watched(packet: bytes) -> NDArray[np.int32]:
    """Return viewer and programme, ``(n, 2)``."""
    return np.frombuffer(packet, "<i4").reshape(-1, 2)


def pack_recommended(wished: float, slot: int, numbers: list[int]) -> bytes:
    """Return a packet: when the viewer asked for it [s] or 0, slot, and programmes."""
    return _SLOT.pack(wished, slot) + np.array(numbers, "<i4").tobytes()


def unpack_recommended(packet: bytes) -> tuple[float, int, list[int]]:
    wished, slot = _SLOT.unpack_from(packet)
    return wished, slot, np.frombuffer(packet, "<i4", offset=_SLOT.size).tolist()
