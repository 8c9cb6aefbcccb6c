"""An observed graph becomes a robot file that Poise accepts, and can plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise import plan
from poise.model import load
from poise.plan import problem_of
from poise.session.ros2_import.graph_records import (
    Age,
    Call,
    Flow,
    Graph,
    Hardware,
    NodeProcess,
    Topic,
)
from poise.session.ros2_import.import_robot import RobotText, hardware_keys
from poise.session.ros2_import.node_processes import WhereImported

STAMPS = tuple(range(20))
GRAPH = Graph(
    computer=Hardware(
        name="board", cores=2, memory=2**32, other_cpu=0.2, other_memory=2**30
    ),
    seconds=30.2,
    own_cpu=0.021,
    processes=(
        NodeProcess(
            pid=1,
            nodes=("/lidar",),
            arguments=("/opt/ros/kilted/lib/lidar/node",),
            cpu=0.1,
            memory=40 * 2**20,
            devices=("/dev/ttyUSB0",),
        ),
        NodeProcess(
            pid=2,
            nodes=("/nav/localiser", "/nav/mapper"),
            arguments=("/opt/ros/kilted/lib/nav/all",),
            folder="/robot",
            cpu=0.9,
            memory=80 * 2**20,
        ),
        NodeProcess(pid=3, nodes=("/pilot",), cpu=0.4),
    ),
    topics=(
        Topic(
            name="/scan",
            type="sensor_msgs/msg/LaserScan",
            flows=(
                Flow(
                    node="/lidar",
                    rate=10.0,
                    size=1500.4,
                    age=Age(0.001, 0.002),
                    stamps=STAMPS,
                ),
            ),
            subscribers=("/nav/localiser", "/nav/mapper", "/far"),
            quality="best effort",
        ),
        Topic(
            name="/pose",
            type="geometry_msgs/msg/PoseStamped",
            flows=(
                Flow(
                    node="/nav/localiser",
                    rate=10.0,
                    size=60.0,
                    age=Age(0.012, 0.04),
                    stamps=STAMPS[:10],
                ),
            ),
            subscribers=("/pilot", "/nav/mapper"),
        ),
        Topic(
            name="/mine",
            type="mine_msgs/msg/Own",
            flows=(Flow(node="/pilot"),),
            subscribers=("/lidar",),
            unmeasured="mine_msgs/msg/Own is not installed here",
        ),
    ),
    calls=(
        Call(
            name="/map",
            type="nav_msgs/srv/GetMap",
            kind="service",
            clients=("/pilot",),
            servers=("/nav/mapper",),
        ),
    ),
    elsewhere={"/far": "it runs on another computer"},
    remarks=("/gone ended meanwhile",),
)
HERE = WhereImported(
    folder="/robot", environment={}, python="/usr/bin/python3", read=lambda file: file
)


def written(
    graph: Graph = GRAPH, computers: Mapping[str, Mapping[str, str]] | None = None
) -> str:
    machines = {"main": hardware_keys(graph), **(computers or {})}
    return RobotText(graph, "r", machines, HERE).write()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    more = {"vision": {"cpu": "2", "memory": "2 GiB"}}
    path = tmp_path / "robot.yaml"
    path.write_text(written(computers=more))
    return path


def test_a_process_becomes_a_component_with_what_it_needs(file: Path) -> None:
    robot = load(file)
    lidar, nav, pilot = (robot.component(n) for n in ("lidar", "all", "pilot"))
    assert lidar.command[0] == "ros2:lidar/node"
    assert lidar.demand == {"cpu": pytest.approx(0.1), "memory": 50 * 2**20}
    assert nav.command == ("ros2:nav/all",)
    assert pilot.command == ()


def test_says_where_programs_of_packages_were_started_before() -> None:
    moved = replace(GRAPH.processes[0], folder="/home/me")
    text = written(replace(GRAPH, processes=(moved, *GRAPH.processes[1:])))
    assert "# Programs of packages that were started in /home/me\n" in text
    assert "started in" not in written(replace(GRAPH, processes=GRAPH.processes[1:]))


def test_a_driver_stays_with_its_device(file: Path) -> None:
    robot = load(file)
    assert robot.component("lidar").devices == ("ttyUSB0",)
    assert robot.device("ttyUSB0").computer == "main"


def test_this_computer_keeps_free_what_others_take(file: Path) -> None:
    main = load(file).computer("main")
    assert main.capacity == {"cpu": 2.0, "memory": 2**32}
    assert main.reserve == {"cpu": 0.1, "memory": 0.25}


def test_connectors_are_between_processes_and_have_rate_and_size(file: Path) -> None:
    found = {str(c): (c.message, c.rate) for c in load(file).all_connectors()}
    assert found == {
        "lidar-all /scan": (1500.0, 10.0),
        "all-pilot /pose": (60.0, 10.0),
        "pilot-lidar /mine": (0.0, 0.0),
        "pilot-all /map": (0.0, 0.0),
    }


def test_the_task_that_runs_leaves_out_what_cannot_be_started(file: Path) -> None:
    robot = load(file)
    assert robot.functions_of("work") == ("lidar", "all")
    assert robot.functions_of("plan_all") == ("lidar", "all", "pilot")


def test_text_that_looks_like_a_number_stays_text(tmp_path: Path) -> None:
    words = ("/opt/ros/k/lib/lidar/node", "12e5", "--ros-args", "-p", "id:='1e3'")
    lidar = replace(GRAPH.processes[0], arguments=words)
    path = tmp_path / "robot.yaml"
    path.write_text(written(replace(GRAPH, processes=(lidar, *GRAPH.processes[1:]))))
    node = load(path).component("lidar").ros2
    assert node is not None
    assert (node.params, node.arguments) == ({"id": "1e3"}, ("12e5",))


def test_what_looks_like_an_argument_of_a_robot_file_stays_text(tmp_path: Path) -> None:
    text = "$(find x) $(gain) $$(gain)"
    words = ("/opt/ros/k/lib/lidar/node", text, "--ros-args", "-p", f"cmd:={text}")
    lidar = replace(
        GRAPH.processes[0], arguments=words, environment={"ROS_X": "$(gain)"}
    )
    path = tmp_path / "robot.yaml"
    path.write_text(written(replace(GRAPH, processes=(lidar, *GRAPH.processes[1:]))))
    component = load(path).component("lidar")
    assert component.ros2 is not None
    assert component.ros2.params == {"cmd": text}
    assert component.ros2.arguments == (text,)
    assert component.environment["ROS_X"] == "$(gain)"


def test_can_be_planned(file: Path) -> None:
    result = plan.solve(problem_of(load(file)))
    assert result.feasible
    assert result.placement["lidar"] == "main"  # where its device is


@pytest.mark.parametrize(
    "sentence",
    [
        "# /far is missing: it runs on another computer.",
        "# /gone ended meanwhile.",
        "took 2.1% of a core itself",
        "# /nav/localiser, /nav/mapper: one process, measured and placed as one",
        "# pilot: its command line cannot be read",
        "# pilot is for planning only",
        "not measured: mine_msgs/msg/Own is not installed here",
        "#   pose: {through: [lidar, all, pilot], deadline: '?'} # age at arrival",
        "median 12 ms, 99 % within 40 ms",
    ],
)
def test_says_what_is_not_known(sentence: str) -> None:
    assert sentence in written()


def test_two_processes_with_one_name_are_two_components() -> None:
    twice = (GRAPH.processes[0], replace(GRAPH.processes[0], pid=9))
    text = written(replace(GRAPH, processes=twice, topics=(), calls=()))
    assert "  lidar_2:\n" in text
    assert "connectors" not in text
