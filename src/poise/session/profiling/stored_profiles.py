"""Finds a robot's profiles and fills in its demands."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from poise.errors import RobotError
from poise.estimate.demands import missing, with_profile
from poise.estimate.profile import Profile
from poise.estimate.profile import file as profile_file
from poise.estimate.profile.code_version import version_of
from poise.estimate.profile.store import Store
from poise.model.robot import Robot
from poise.session.writable import to_write

_MOST_NAMED = 4
STORE = Path(".poise") / "profiles.sqlite"


class Profiled(Struct, frozen=True):
    """A robot with its demands filled in, and sentences about their sources."""

    robot: Robot
    says: tuple[str, ...] = ()


def read_profile(robot: Robot) -> Profile | None:
    """Return the profile that the robot file names; None if it does not exist.

    Raises
    ------
    RobotError
        The file is not a profile.
    """
    path = Path(robot.folder) / robot.profile
    if not robot.profile or not path.exists():
        return None
    return profile_file.read(path)


def store_of(robot: Robot) -> Store:
    """Return the store of all profiles of the robots in this folder.

    Raises
    ------
    UsageError
        It cannot be created.
    """
    return Store(Path(robot.folder) / STORE)


def check_keepable(robot: Robot) -> None:
    """Raise UsageError when a result could not be written."""
    with store_of(robot):
        to_write(Path(robot.folder) / robot.profile if robot.profile else None)


def profiled(robot: Robot) -> Profiled:
    """Return the robot with measured demands where its file has none.

    Raises
    ------
    RobotError
        The file is not a profile of this robot.
    """
    profile = read_profile(robot)
    if profile is None:
        asked = f"{robot.profile} does not exist: `poise profile` measures it"
        return Profiled(robot, (asked,) if robot.profile else ())
    if profile.robot != robot.name:
        raise RobotError(
            f"{robot.profile} is the profile of robot '{profile.robot}', not of "
            f"'{robot.name}'"
        )
    source = f"{robot.profile}, measured by `poise profile` on '{profile.computer}'"
    says = [f"demands from {source}, {profile.at}"]
    says.append(
        "overheads from measured costs of connectors"
        if profile.costs
        else "overheads are MB/s: `poise calibrate` measures the costs of connectors"
    )
    own = [
        component.name
        for component in robot.components()
        if component.name in profile.components
        and {"cpu", "memory"} <= component.demand.keys()
    ]
    if own:
        says.append(f"demands from the robot file, which win: {_some(own)}")
    gaps = missing(robot, profile)
    if gaps:
        says.append(f"no demand is known of: {_some(gaps)}")
    old = stale(robot, profile)
    if old:
        says.append(f"changed since they were measured: {_some(old)}")
    return Profiled(with_profile(robot, profile), tuple(says))


def _some(names: list[str]) -> str:
    """Return the names, or the first few of many."""
    if len(names) <= _MOST_NAMED:
        return ", ".join(names)
    return f"{', '.join(names[:_MOST_NAMED])} and {len(names) - _MOST_NAMED} more"


def stale(robot: Robot, profile: Profile) -> list[str]:
    """Return the components whose code or parameters changed since the measurement."""
    return [
        component.name
        for component in robot.components()
        if component.name in profile.components
        and profile.components[component.name].version
        != version_of(component, robot.folder, *robot.repository)
    ]
