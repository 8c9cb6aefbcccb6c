"""Lets emulated computers be as quick as on the machine where they were profiled."""

from __future__ import annotations

import contextlib

from msgspec.structs import replace

from poise.emulate import full_speed
from poise.model.robot import Robot
from poise.runtime.workload.calibration import score
from poise.session.profiling.stored_profiles import read_profile

_SERIES = 12


def steady(robot: Robot) -> contextlib.AbstractContextManager[None]:
    """Keep this machine at full speed where it emulates the robot's computers."""
    return full_speed() if is_emulated(robot) else contextlib.nullcontext()


def is_emulated(robot: Robot) -> bool:
    """Return whether this machine emulates the robot's computers."""
    return all(computer.address is None for computer in robot.computers)


def loops() -> float:
    """Return how much work a CPU second does here, undisturbed [loops/s]."""
    return max(score() for _ in range(_SERIES))


def as_when_profiled(robot: Robot) -> Robot:
    """Return the robot with computers as quick as its profile was measured with.

    A core of this machine may do more or less than one of the machine of the profile:
    by so much less or more time of it emulates the same computer.
    """
    profile = read_profile(robot)
    if profile is None or not profile.loops or not is_emulated(robot):
        return robot
    factor = profile.loops / loops()
    computers = (replace(c, speed=c.speed * factor) for c in robot.computers)
    return replace(robot, computers=tuple(computers))
