"""A robot file becomes records in SI, from one file or several."""

import os
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from poise.errors import FileProblem, RobotError
from poise.model import load
from poise.model.loading import load_source
from poise.model.robot import (
    Computer,
    Connector,
    ConnectorEnd,
    DeclaredPort,
    Device,
    Link,
    Objective,
    Simulator,
)

Find = Callable[[str], tuple[FileProblem, ...]]

ROBOT = """
robot: t-rot
computers:
  main: {cpu: 1, memory: 1 GiB, resources: {gpu: 1}, speed: 0.5, reserve: 5%}
  vision: {cpu: 150%, memory: 512 MiB, reserve: {cpu: 10%}}
devices:
  laser: {computer: main, path: laser.sock}
links:
  - {between: [main, vision], bandwidth: 100 Mbit/s, latency: 0.2 ms, distance: 2}
architectures:
  navigator:
    function: navigation
    priority: 10
    home: main
    components:
      scanner: {implementation: "trot.nav:Scanner", cpu: 3%, devices: [laser]}
      localiser:
        implementation: trot.nav:Localiser
        memory: 40 MiB
        state: 20 kB
        parameters: {particles: 300, on: yes, gain: 1e3, none: ~, deep: [{a: 0.5}]}
        isolated: true
        movable: false
        only: [main]
      recorder:
        command: rosbag record "two words"
        resources: {gpu: 0.5}
        ports: {scan: {subscribes: trot.messages:Scan}}
    connectors:
      - {between: [scanner.scan, localiser.scan], message: 1.5 kB, rate: 10 Hz}
connectors:
  - {between: [scanner.scan, recorder.scan], overhead: 3, limit: 100 ms}
chains:
  pose: {through: [scanner, localiser], deadline: 200 ms}
tasks:
  fetch: {actions: [{name: drive, functions: [navigation]}]}
objective: {communication: 5, balance: 1, quality: 2, scale: paper,
            sizes: {memory: 3}}
together: [[scanner, localiser]]
apart: [[localiser, recorder]]
simulator: {command: [python, -m, trot.world]}
"""


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return path


def test_reads_computers_devices_and_links(robot_file: Path) -> None:
    robot = load(robot_file)
    assert robot.name == "t-rot"
    assert robot.folder == str(robot_file.parent)
    assert robot.computers == (
        Computer(
            name="main",
            capacity={"cpu": 1.0, "memory": 1024.0**3, "gpu": 1.0},
            speed=0.5,
            reserve={"cpu": 0.05, "memory": 0.05},
        ),
        Computer(
            name="vision",
            capacity={"cpu": 1.5, "memory": 512 * 1024.0**2},
            reserve={"cpu": 0.1},
        ),
    )
    # 1 core x 0.5 - 5%
    assert robot.computer("main").usable("cpu") == pytest.approx(0.475)
    assert robot.devices == (Device(name="laser", computer="main", path="laser.sock"),)
    assert robot.links == (
        Link(
            between=("main", "vision"), bandwidth=12.5e6, latency=0.2 * 1e-3, distance=2
        ),
    )


def test_reads_components(robot_file: Path) -> None:
    (architecture,) = load(robot_file).architectures
    assert (architecture.function, architecture.priority) == ("navigation", 10)
    assert (architecture.layer, architecture.home) == ("sequencing", "main")
    scanner, localiser, recorder = architecture.components
    assert scanner.implementation == "trot.nav:Scanner"
    assert scanner.demand == {"cpu": pytest.approx(0.03)}
    assert scanner.devices == ("laser",)
    assert localiser.state == 20_000
    assert (localiser.isolated, localiser.movable) == (True, False)
    assert localiser.only == ("main",)
    assert recorder.command == ("rosbag", "record", "two words")
    assert recorder.demand["gpu"] == 0.5
    assert recorder.ports == (
        DeclaredPort(name="scan", kind="subscribes", type="trot.messages:Scan"),
    )


def test_parameters_mean_what_they_mean_in_yaml_1_2(robot_file: Path) -> None:
    (architecture,) = load(robot_file).architectures
    assert architecture.components[1].parameters == {
        "particles": 300,
        "on": "yes",
        "gain": 1000.0,
        "none": None,
        "deep": [{"a": 0.5}],
    }


def test_reads_connectors_chains_tasks_and_the_rest(robot_file: Path) -> None:
    robot = load(robot_file)
    (own,) = robot.architectures[0].connectors
    assert own.traffic == 15_000
    assert robot.connectors == (
        Connector(
            between=(ConnectorEnd("scanner", "scan"), ConnectorEnd("recorder", "scan")),
            overhead=3.0,
            limit=100 * 1e-3,
        ),
    )
    assert robot.chains[0].through == ("scanner", "localiser")
    assert robot.chains[0].deadline == pytest.approx(0.2)
    assert robot.functions_of("fetch") == ("navigation",)
    assert robot.objective == Objective(
        communication=5, balance=1, scale="paper", sizes={"memory": 3}, quality=2
    )
    assert robot.together == (("scanner", "localiser"),)
    assert robot.apart == (("localiser", "recorder"),)
    assert robot.simulator == Simulator(command=("python", "-m", "trot.world"))


def test_positions_find_any_part_again(robot_file: Path) -> None:
    positions = load_source(robot_file).positions
    place = positions.at(
        ("architectures", "navigator", "components", "localiser", "only", 0)
    )
    assert (place.file, place.line, place.column) == (str(robot_file), 24, 16)
    above = positions.at(("connectors", 0, "nothing", "here"))
    assert (above.line, above.column) == (32, 5)


def test_reads_the_paper_example() -> None:
    robot = load(Path(__file__).parents[2] / "examples/paper/robot.yaml")
    assert [c.name for c in robot.components()] == ["C1", "C2", "C3"]
    assert [c.demand["cpu"] for c in robot.components()] == [20, 40, 15]
    assert [c.cost for c in robot.architectures[0].connectors] == [1.5, 1, 2]


def test_a_folder_is_no_robot_file(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="is a folder, not a file") as error:
        load(tmp_path)
    assert error.value.problems[0].line == 0


def test_a_missing_file_is_a_problem(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"nothing\.yaml: does not exist$"):
        load(tmp_path / "nothing.yaml")


def test_a_file_in_a_working_directory_that_was_removed_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(RobotError, match=r"robot\.yaml: does not exist"):
        load("robot.yaml")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RobotError, match="is not an ordinary file"):
        load(tmp_path / "pipe")


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with path.open("wb") as stream:
        stream.truncate(10**12)
    with pytest.raises(RobotError, match="is larger than 1000000 bytes"):
        load(path)


def test_text_that_is_not_utf_8_is_told_with_its_place(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(b"robot: r\nx: \xff\n")
    with pytest.raises(RobotError, match=r"robot\.yaml:2:4: is not UTF-8"):
        load(path)


def test_a_list_is_no_robot(find: Find) -> None:
    (problem,) = find("- robot\n")
    assert "a robot file must be a mapping" in problem.message


def test_links_in_a_circle_are_no_file(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(RobotError, match="cannot be read: Too many levels of symbolic"):
        load(tmp_path / "a")


def test_a_nul_is_in_no_file_name() -> None:
    with pytest.raises(RobotError, match="is not a file name"):
        load("a\0b")


def test_a_folder_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    """No other process could be told of it."""
    folder = tmp_path / "x\udcff"
    folder.mkdir()
    file = folder / "robot.yaml"
    file.write_text("robot: r\ncomputers: {a: {cpu: 1, memory: 1 GiB}}\n")
    with pytest.raises(RobotError, match="folder's name is not UTF-8"):
        load(file)


def test_a_link_without_limit_is_read_back_as_it_was_written() -> None:
    link = Link(between=("a", "b"), bandwidth=float("1e999"))
    assert msgspec.json.decode(msgspec.json.encode(link), type=Link) == link


def test_a_file_for_a_newer_poise_is_refused_by_that_alone(find: Find) -> None:
    """Its other keys may be new, too."""
    (problem,) = find(f"poise: 99.1\nwarp: 9\n{ROBOT}")
    assert problem.line == 1
    assert "it needs Poise 99.1, and this is" in problem.message
    (problem,) = find(f"poise: soon\n{ROBOT}")
    assert "'soon' is not a valid version; one is 0.2" in problem.message


def test_a_file_for_this_poise_or_an_older_one_is_read(robot_file: Path) -> None:
    robot_file.write_text(f"poise: 0.1\n{robot_file.read_text()}")
    assert load(robot_file).poise == "0.1"
