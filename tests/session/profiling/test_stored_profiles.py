import resource
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import RobotError, RunError
from poise.estimate import profiles as profile_file
from poise.estimate.code_version import version_of
from poise.estimate.profiles import (
    ComponentProfile,
    Distribution,
    HandlerProfile,
    Profile,
)
from poise.model import load
from poise.model.robot import Robot
from poise.session.profiling.stored_profiles import (
    profiled,
    read_profile,
    stale,
    write_demands,
)

TEXT = """\
robot: r
computers:
  a: {cpu: 1, memory: 1 GiB}
architectures:
  see:
    function: seeing
    components:
      eye: {implementation: "eyes:Eye"} # looks
      ear: {implementation: "ears:Ear", cpu: 7%}
profile: profile.yaml
"""


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    (tmp_path / "robot.yaml").write_text(TEXT)
    (tmp_path / "eyes.py").write_text("class Eye: ...\n")
    return load(tmp_path / "robot.yaml")


def measured(robot: Robot) -> Profile:
    """Return a profile of the eye: 20 % sustained, 10 MB."""
    eye = next(robot.components())
    found = ComponentProfile(
        version=version_of(eye, robot.folder),
        cpu=Distribution(mean=0.1, sustained=0.2),
        memory=10e6,
    )
    return Profile(
        robot="r",
        poise="0",
        computer="a",
        speed=1.0,
        at="today",
        seconds=1.0,
        components={"eye": found},
    )


def write(robot: Robot, profile: Profile) -> None:
    path = Path(robot.folder) / "profile.yaml"
    path.write_text(profile_file.to_text(profile))


def test_says_where_demands_are_from_and_what_is_missing(robot: Robot) -> None:
    write(robot, measured(robot))
    said: list[str] = []
    eye, ear = profiled(robot, said.append).components()
    assert said == [
        "demands from profile.yaml, measured by `poise profile` on 'a', today",
        "overheads are MB/s: `poise calibrate` measures the costs of connectors",
        "no demand is known of: ear",
    ]
    assert eye.demand == pytest.approx({"cpu": 0.21, "memory": 11e6})
    assert ear.demand == pytest.approx({"cpu": 0.07})


def test_says_that_the_robot_files_own_demands_go_first(robot: Robot) -> None:
    folder = Path(robot.folder)
    own = '"eyes:Eye", cpu: 30%, memory: 20 MB}'
    (folder / "robot.yaml").write_text(TEXT.replace('"eyes:Eye"}', own))
    robot = load(folder / "robot.yaml")
    write(robot, measured(robot))
    said: list[str] = []
    found = profiled(robot, said.append)
    assert "demands from the robot file, which take precedence: eye" in said
    assert next(found.components()).demand == {"cpu": 0.3, "memory": 20e6}


def test_says_that_a_profile_is_stale(robot: Robot) -> None:
    write(robot, measured(robot))
    assert stale(robot, measured(robot)) == []
    (Path(robot.folder) / "eyes.py").write_text("class Eye:\n    x = 1\n")
    said: list[str] = []
    profiled(robot, said.append)
    assert "changed since they were measured: eye" in said


@pytest.mark.parametrize(
    ("address", "loops", "factor"),
    [("address: 10.0.0.1, ", 0.0, 2.0), ("", 0.0, 1.0), ("", 5e3, 1.0)],
)
def test_cpu_of_a_real_computer_is_given_for_the_speed_that_it_has_now(
    robot: Robot, address: str, loops: float, factor: float
) -> None:
    profile = measured(robot)
    eye = replace(
        profile.components["eye"],
        share=0.01,
        handlers={"look": HandlerProfile(mean=0.01, median=0.01, p99=0.01)},
    )
    write(robot, replace(profile, loops=loops, components={"eye": eye}))
    text = TEXT.replace("a: {", f"a: {{{address}speed: 2, ")
    (Path(robot.folder) / "robot.yaml").write_text(text)
    robot = load(Path(robot.folder) / "robot.yaml")
    found = read_profile(robot)
    assert found is not None
    assert found.speed == factor
    now = found.components["eye"]
    assert now.cpu.sustained == 0.2 * factor
    assert now.share == 0.01 * factor
    assert now.handlers["look"].mean == 0.01 * factor
    demand = next(profiled(robot).components()).demand["cpu"]
    assert demand == pytest.approx((0.2 + 0.01) * 1.05 * factor)


def test_says_what_measures_a_profile_that_is_not_there(robot: Robot) -> None:
    said: list[str] = []
    assert profiled(robot, said.append) == robot
    assert said == ["profile.yaml does not exist: `poise profile` measures it"]
    said.clear()
    profiled(replace(robot, profile=""), said.append)
    assert said == []


def test_refuses_the_profile_of_another_robot(robot: Robot) -> None:
    write(robot, replace(measured(robot), robot="other"))
    with pytest.raises(RobotError, match="the profile of robot 'other', not of 'r'"):
        profiled(robot)


def test_writes_demands_into_the_robot_file(robot: Robot) -> None:
    file = Path(robot.folder) / "robot.yaml"
    assert write_demands(file, measured(robot)) == [file]
    assert file.read_text() == TEXT.replace(
        "eye: {impl", "eye: {cpu: 21%, memory: 10.5 MiB, impl"
    )
    assert write_demands(file, measured(robot)) == []


def both(robot: Robot) -> Profile:
    """Return a profile of the eye, and of an ear that needs half of its CPU."""
    profile = measured(robot)
    eye = profile.components["eye"]
    ear = replace(eye, cpu=Distribution(sustained=0.1))
    return replace(profile, components={"eye": eye, "ear": ear})


EYE = "cpu: 21%, memory: 10.5 MiB, "
EAR = "cpu: 10.5%, memory: 10.5 MiB, "


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (
            "{eye: {movable: true}, ear: {state: 1}}",
            f"{{eye: {{{EYE}movable: true}}, ear: {{{EAR}state: 1}}}}",
        ),
        (
            "\n      eye: {\n  movable: true}\n      ear: {state: 1}",
            f"\n      eye: {{\n  {EYE}movable: true}}\n      ear: {{{EAR}state: 1}}",
        ),
        ("{ear: &e {state: 1}, eye: *e}", f"{{ear: &e {{{EYE}state: 1}}, eye: *e}}"),
    ],
)
def test_writes_demands_in_any_style(robot: Robot, before: str, after: str) -> None:
    file = Path(robot.folder) / "robot.yaml"
    head = TEXT[: TEXT.index("\n      eye")] + " "
    file.write_text(head + before)
    write_demands(file, both(robot))
    assert file.read_text() == head + after


def test_a_file_included_twice_gets_the_larger_demand(robot: Robot) -> None:
    folder = Path(robot.folder)
    part = "architectures: {see: {function: f, components: {e: {movable: true}}}}"
    (folder / "part.yaml").write_text(part)
    include = "include: [{file: part.yaml, prefix: a}, {file: part.yaml, prefix: b}]"
    (folder / "robot.yaml").write_text(
        f"robot: r\n{include}\ncomputers: {{a: {{cpu: 1, memory: 1 GiB}}}}\n"
    )
    eye, ear = both(robot).components.values()
    profile = replace(both(robot), components={"ae": ear, "be": eye})
    assert write_demands(folder / "robot.yaml", profile) == [folder / "part.yaml"]
    written = (folder / "part.yaml").read_text()
    assert written == part.replace("movable", f"{EYE}movable")


def test_keeps_the_ends_of_lines(robot: Robot) -> None:
    file = Path(robot.folder) / "robot.yaml"
    before = TEXT.replace("\n", "\r\n").encode()
    file.write_bytes(before)
    write_demands(file, measured(robot))
    demands = b"eye: {cpu: 21%, memory: 10.5 MiB, impl"
    assert file.read_bytes() == before.replace(b"eye: {impl", demands)


def test_a_robot_file_that_cannot_be_written_stays_what_it_was(robot: Robot) -> None:
    file = Path(robot.folder) / "robot.yaml"
    link = Path(robot.folder) / "link.yaml"
    link.symlink_to(file)
    file.chmod(0o640)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # as on a disk that is full
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(TEXT) - 1, limits[1]))
    try:
        with pytest.raises(RunError, match="cannot be written: File too large"):
            write_demands(file, measured(robot))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_text() == TEXT
    assert not list(file.parent.glob(".*.new"))
    write_demands(link, measured(robot))
    assert "cpu: 21%" in file.read_text()
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o640
