"""A command line of ROS 2 becomes the keys that start it again."""

from __future__ import annotations

from typing import Any

import pytest

from poise.session.ros2_import.graph_records import NodeProcess
from poise.session.ros2_import.node_processes import (
    WhereImported,
    component_name,
    name_of,
    parameters_in,
    start_of,
)

PARAMETERS = """
/**:
  ros__parameters: {use_sim_time: false, rate: 10}
/front/lidar:
  ros__parameters: {rate: 20, filter: {size: 3}}
other:
  ros__parameters: {rate: 99}
"""


def read(file: str) -> str:
    if file == "/tmp/launch_params_x":
        return PARAMETERS
    raise FileNotFoundError(file)


HERE = WhereImported(
    folder="/home/me/robot",
    environment={"ROS_DOMAIN_ID": "3"},
    python="/venv/bin/python",
    read=read,
)


def process(line: str, **more: Any) -> NodeProcess:
    values: dict[str, Any] = {
        "pid": 7,
        "nodes": ("/front/lidar",),
        "arguments": tuple(line.split()),
        "folder": "/home/me/robot",
        "environment": {"ROS_DOMAIN_ID": "3"},
    }
    return NodeProcess(**(values | more))


def keys(line: str, **more: Any) -> Any:
    return start_of(process(line, **more), HERE).keys


def test_finds_package_and_executable_of_what_ros2_run_starts() -> None:
    assert keys("/opt/ros/kilted/lib/demo_nodes_cpp/talker", folder="/home/me") == {
        "ros2": {"package": "demo_nodes_cpp", "executable": "talker"}
    }


def test_finds_those_of_a_script_that_python_runs() -> None:
    line = "/usr/bin/python3 /ws/install/nav/lib/nav/planner --fast"
    assert keys(line) == {
        "ros2": {"package": "nav", "executable": "planner", "arguments": ["--fast"]}
    }


def test_finds_name_namespace_remappings_and_parameters() -> None:
    line = (
        "/opt/ros/kilted/lib/lidar/node --ros-args -r __node:=lidar -r __ns:=/front "
        "-r scan:=/front/scan -p rate:=5.5 --param frame:=base --log-level debug"
    )
    assert keys(line)["ros2"] == {
        "package": "lidar",
        "executable": "node",
        "name": "lidar",
        "namespace": "/front",
        "remap": {"scan": "/front/scan"},
        "params": {"rate": 5.5, "frame": "base"},
        "arguments": ["--ros-args", "--log-level", "debug", "--"],
    }


def test_takes_over_what_temporary_parameter_files_say_for_the_node() -> None:
    line = (
        "/opt/ros/kilted/lib/lidar/node --ros-args --params-file /tmp/launch_params_x "
        "--params-file cfg/more.yaml -p rate:=30"
    )
    assert keys(line)["ros2"] == {
        "package": "lidar",
        "executable": "node",
        "params": {"use_sim_time": False, "rate": 30, "filter": {"size": 3}},
        "params_files": ["cfg/more.yaml"],
    }


def test_says_that_parameters_are_missing_when_their_file_is_gone() -> None:
    line = "/opt/ros/kilted/lib/lidar/node --ros-args --params-file /tmp/gone"
    (remark,) = start_of(process(line), HERE).remarks
    assert remark == "parameters are missing: /tmp/gone: /tmp/gone"


def test_takes_a_script_in_the_folder_of_the_robot_file_as_an_executable() -> None:
    assert keys("/venv/bin/python nodes/lidar.py --ros-args -p rate:=5") == {
        "ros2": {"executable": "nodes/lidar.py", "params": {"rate": 5}}
    }
    assert keys("/venv/bin/python3 lidar.py") == {"ros2": {"executable": "./lidar.py"}}
    assert keys("/venv/bin/python /home/me/robot/lidar.py") == {
        "ros2": {"executable": "./lidar.py"}
    }


@pytest.mark.parametrize(
    ("line", "folder", "command"),
    [
        ("/venv/bin/python -m nav.lidar", "/home/me/robot", "python -m nav.lidar"),
        ("/venv/bin/python a.py x", "/ws", "env -C /ws /venv/bin/python a.py x"),
        ("/other/bin/python lidar.py", "/home/me/robot", "/other/bin/python lidar.py"),
        ("/usr/local/bin/drive --now", "/home/me/robot", "/usr/local/bin/drive --now"),
    ],
)
def test_starts_anything_else_by_its_command_line(
    line: str, folder: str, command: str
) -> None:
    ros2 = keys(f"{line} --ros-args -r a:=b", folder=folder)["ros2"]
    assert [ros2["executable"], *ros2["arguments"]] == command.split()
    assert ros2["remap"] == {"a": "b"}


def test_keeps_what_its_environment_says_otherwise() -> None:
    environment = {"ROS_DOMAIN_ID": "4", "PYTHONPATH": "/ws"}
    found = keys("/opt/ros/kilted/lib/lidar/node", environment=environment)
    assert found["environment"] == environment


def test_knows_nothing_without_a_command_line() -> None:
    start = start_of(process(""), HERE)
    assert (start.keys, start.remarks) == ({}, ("its command line cannot be read",))


def test_parameters_of_another_node_are_not_taken() -> None:
    assert parameters_in(PARAMETERS, "/rear/lidar") == {
        "use_sim_time": False,
        "rate": 10,
    }


def test_one_process_with_several_nodes_is_called_after_its_program() -> None:
    nodes = ("/a", "/b")
    assert component_name(process("/venv/bin/python -m nav.all", nodes=nodes)) == "all"
    assert component_name(process("/opt/lib/x/many", nodes=nodes)) == "many"
    assert component_name(process("")) == "front_lidar"


def test_names_are_those_of_a_robot_file() -> None:
    assert [name_of(n) for n in ("/a/b-c", "/_x", "/3d")] == ["a_b_c", "n_x", "n3d"]
