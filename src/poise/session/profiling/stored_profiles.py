"""Finds a robot's profiles and fills in its demands."""

from __future__ import annotations

import contextlib
from pathlib import Path

from msgspec.structs import replace

from poise.emulate import full_speed
from poise.errors import RobotError
from poise.estimate import profiles as profile_file
from poise.estimate.code_version import version_of
from poise.estimate.demands import cpu_demand, memory_demand, missing, with_profile
from poise.estimate.profiles import ComponentProfile, Profile, Store
from poise.model.loading import load_source
from poise.model.robot import Robot
from poise.model.yaml_tree import Location, with_values
from poise.runtime.calibration import score
from poise.session import Say, nothing
from poise.session.folders import to_write, write_whole

_MOST_NAMED = 4
STORE = Path(".poise") / "profiles.sqlite"


def read_profile(robot: Robot) -> Profile | None:
    """Return the profile that the robot file names; None if it does not exist.

    The CPU of a real computer is given for the speed that it has in the robot file now.
    """
    path = Path(robot.folder) / robot.profile
    if not robot.profile or not path.exists():
        return None
    profile = profile_file.read(path)
    speeds = {c.name: c.speed for c in robot.computers if c.address}
    speed = speeds.get(profile.computer, profile.speed)
    # of one that was emulated, no speed changes what the machine did
    if profile.loops or not profile.speed or profile.robot != robot.name:
        return profile
    return profile_file.with_speed(profile, speed)


def own_profile(robot: Robot) -> Profile | None:
    """Return what `read_profile` does; RobotError: it is that of another robot."""
    profile = read_profile(robot)
    if profile is not None and profile.robot != robot.name:
        raise RobotError(
            f"{robot.profile} is the profile of robot '{profile.robot}', not of "
            f"'{robot.name}': name a file of its own there, and `poise profile` "
            "measures it"
        )
    return profile


def write_profile(robot: Robot, profile: Profile) -> Path | None:
    """Write the profile that the robot file names; return its file, if it names one."""
    if not robot.profile:
        return None
    path = Path(robot.folder) / robot.profile
    write_whole(path, profile_file.to_text(profile))
    return path


def store_of(robot: Robot) -> Store:
    """Return the store of all profiles of the robots in this folder."""
    return Store(Path(robot.folder) / STORE)


def kept_profiles(robot: Robot) -> list[Profile]:
    """Return the profiles of a robot in its store, newest first; write nothing."""
    if not (Path(robot.folder) / STORE).exists():
        return []
    with store_of(robot) as store:
        return store.all(robot.name)


def check_keepable(robot: Robot) -> None:
    """Raise UsageError when a result could not be written."""
    with store_of(robot) as store:
        store.latest_costs(robot.name)  # they go into the result
        to_write(Path(robot.folder) / robot.profile if robot.profile else None)


def profiled(robot: Robot, say: Say = nothing) -> Robot:
    """Return the robot with measured demands where its file has none; say whence."""
    profile = own_profile(robot)
    if profile is None:
        if robot.profile:
            say(f"{robot.profile} does not exist: `poise profile` measures it")
        return robot
    source = f"{robot.profile}, measured by `poise profile` on '{profile.computer}'"
    say(f"demands from {source}, {profile.at}")
    say(
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
        say(f"demands from the robot file, which take precedence: {_some(own)}")
    if gaps := missing(robot, profile):
        say(f"no demand is known of: {_some(gaps)}")
    if old := stale(robot, profile):
        say(f"changed since they were measured: {_some(old)}")
    return with_profile(robot, profile)


def _some(names: list[str]) -> str:
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
        != version_of(component, *robot.folders)
    ]


_MIB = 2**20


def write_demands(file: Path, profile: Profile) -> list[Path]:
    """Write the demands of `profile` under the components of a robot file.

    Comments and layout of the file, of included files and of those in folders of
    `repository` are kept. Files of installed packages are not changed. Components that
    are written in one place get the largest of their demands.
    """
    source = load_source(file)
    paths = [
        ("architectures", architecture.name, "components", component.name)
        for architecture in source.robot.architectures
        for component in architecture.components
        if component.name in profile.components and not architecture.package
    ]
    places: dict[Location, list[tuple[str, ...]]] = {}
    for path in paths:  # those of an alias, or of a file included twice, are in one
        places.setdefault(source.positions.first_key(path), []).append(path)
    before = {p.file: Path(p.file).read_bytes().decode() for p in places}
    texts = before
    # from last to first: what is added moves only what is done
    for place in sorted(places, key=lambda p: (p.line, p.column), reverse=True):
        values = _values([profile.components[path[-1]] for path in places[place]])
        texts = with_values(texts, source.positions, places[place][0], values)
    changed = [name for name in texts if texts[name] != before[name]]
    for name in changed:
        write_whole(Path(name), texts[name])
    return [Path(name) for name in changed]


def _values(found: list[ComponentProfile]) -> dict[str, str]:
    return {
        "cpu": f"{100 * max(map(cpu_demand, found)):.3g}%",
        "memory": f"{max(map(memory_demand, found)) / _MIB:.3g} MiB",
    }


_SERIES = 12


def steady(robot: Robot) -> contextlib.AbstractContextManager[None]:
    """Keep this machine at full speed where it emulates the robot's computers."""
    return full_speed() if robot.is_emulated else contextlib.nullcontext()


def loops() -> float:
    """Return how much work a CPU second does here, undisturbed [loops/s]."""
    return max(score() for _ in range(_SERIES))


def as_when_profiled(robot: Robot) -> Robot:
    """Return the robot with computers as quick as its profile was measured with.

    A core of this machine may do more or less than one of the machine of the profile:
    by so much less or more time of it emulates the same computer.
    """
    profile = read_profile(robot)
    if profile is None or not profile.loops or not robot.is_emulated:
        return robot
    factor = profile.loops / loops()
    computers = (replace(c, speed=c.speed * factor) for c in robot.computers)
    return replace(robot, computers=tuple(computers))
