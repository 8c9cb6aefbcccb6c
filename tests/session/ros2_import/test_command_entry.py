"""A command line of ROS 2 becomes the keys that start it again."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
from msgspec import structs

from poise.session.ros2_import.graph_records import NodeProcess
from poise.session.ros2_import.node_processes import (
    ProcessUsage,
    WhereImported,
    component_name,
    describe,
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
        "params": {"use_sim_time": False, "rate": 30, "filter.size": 3},
        "params_files": ["cfg/more.yaml"],
    }


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("y", True),
        ("Off", False),
        ("1:30", "1:30"),
        ("010", 8),
        ("09", 9.0),
        ("0x1F", 31),
        ("+5", 5),
        ("~", "~"),
        ("1_000", "1_000"),
        ("2020-01-01", "2020-01-01"),
        ("123456789012345678901234567890", 123456789012345678901234567890.0),
        ("1e400", "1e400"),
        ("'1e3'", "1e3"),
        ("=", "="),
        ("@x", "@x"),
        ("[1e-3, 2.0]", [0.001, 2.0]),
    ],
)
def test_reads_values_of_parameters_as_rcl_does(text: str, value: object) -> None:
    words = ("/opt/ros/kilted/lib/lidar/node", "--ros-args", "-p", f"x:={text}")
    params = keys("", arguments=words)["ros2"]["params"]
    assert (params, type(params["x"])) == ({"x": value}, type(value))


def test_parameters_that_no_robot_file_holds_are_arguments() -> None:
    values = ("far:=-.inf", "near:=.1", "all:=[]", "ends:=[-.inf, 1.0]", "two:=[1.0]")
    words = [word for value in values for word in ("-p", value)]
    line = ("/opt/ros/kilted/lib/lidar/node", "--ros-args", *words)
    kept = ["-p", "far:=-inf", "-p", "all:=[]", "-p", "ends:=[-inf, 1.0]"]
    assert keys("", arguments=line)["ros2"] == {
        "package": "lidar",
        "executable": "node",
        "params": {"near": 0.1, "two": [1.0]},
        "arguments": ["--ros-args", *kept, "--"],
    }


def test_sections_add_to_parameters_with_one_prefix() -> None:
    text = """
    /**: {ros__parameters: {filter: {size: 3, kind: mean}}}
    /lidar: {ros__parameters: {filter: {size: 5}, y: 1}}
    """
    found = parameters_in(text, "/lidar")
    assert found == {"filter.size": 5, "filter.kind": "mean", "y": 1}


def test_a_file_wins_over_a_temporary_one_before_it() -> None:
    texts = {
        "/tmp/launch_params_x": PARAMETERS,
        "/home/me/robot/cfg/more.yaml": "/**: {ros__parameters: {filter: {size: 9}}}",
    }
    here = structs.replace(HERE, read=texts.__getitem__)
    line = (
        "/opt/ros/kilted/lib/lidar/node --ros-args --params-file /tmp/launch_params_x "
        "--params-file cfg/more.yaml"
    )
    ros2 = start_of(process(line), here).keys["ros2"]
    assert ros2["params"] == {"use_sim_time": False, "rate": 20}
    assert ros2["params_files"] == ["cfg/more.yaml"]


@pytest.mark.parametrize("text", ["- a", "lidar: [1,\n b: {", "hello"])
def test_a_damaged_parameter_file_is_a_remark_on_one_line(text: str) -> None:
    line = "/opt/ros/kilted/lib/lidar/node --ros-args --params-file /tmp/x"
    here = structs.replace(HERE, read=lambda _: text)
    (remark,) = start_of(process(line), here).remarks
    assert remark.startswith("parameters are missing: /tmp/x: ")
    assert "\n" not in remark


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


@pytest.mark.slow
def test_reads_arguments_that_are_empty_from_a_process() -> None:
    words = [sys.executable, "-c", "input()", "", "--frame", "", ""]
    usage = ProcessUsage()
    with subprocess.Popen(words, stdin=subprocess.PIPE) as started:
        usage.add(started.pid)
        found = describe(started.pid, ("/x",), usage)
        started.communicate(b"\n")
    assert list(found.arguments) == words


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
