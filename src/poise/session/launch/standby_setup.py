"""What the standbys of a robot have to know, which agents keep for them."""

from __future__ import annotations

import msgspec
from msgspec import Struct

from poise.emulate import set_for
from poise.model.robot import Robot
from poise.wire.records.request_records import Election


class StandbySetup(Struct, frozen=True, kw_only=True):
    """What a standby has to know of the robot that it may lead."""

    robot: Robot
    adapts: bool = True


def election_of(robot: Robot, *, adapts: bool) -> Election | None:
    """Return how managers of a robot follow each other; None: they do not."""
    is_real = any(computer.address for computer in robot.computers)
    if not robot.standbys or not (is_real or set_for(robot) is not None):
        return None
    return Election(
        votes=robot.votes,
        managers=robot.standbys,
        setup=msgspec.msgpack.encode(StandbySetup(robot=robot, adapts=adapts)),
    )


def without_standbys(robot: Robot) -> str:
    """Return what a person should know of a real robot that has none; empty: it has."""
    real = [computer.name for computer in robot.hosts if computer.address]
    if robot.standbys or len(real) == 1 or not real:
        return ""
    if robot.manager is not None:
        cure = "name some in `manager`, so that one of them leads then"
    else:
        cure = "a witness, or `keeps` in the robot file, lets the other one lead then"
    return (
        "without standbys: when the computer of this manager dies, its components are "
        f"away until the next `poise up`; {cure}"
    )
