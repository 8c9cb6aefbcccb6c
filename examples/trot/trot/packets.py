"""The packets that cross a device's socket: fixed little-endian records.

====================  =============================================================
``wheels.sock``       to the robot 50 times a second: time, x, y, heading as the wheels
                      have counted them; from the robot: forward speed [m/s], turn rate
                      [rad/s]
``laser.sock``        10 times a second: time, then one range [m] for each beam
``microphones.sock``  20 times a second: time, then one row of samples a microphone
``speakers.sock``     from the robot: samples
====================  =============================================================

Times are CLOCK_MONOTONIC [s], which all emulated computers share.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

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
