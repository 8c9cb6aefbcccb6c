"""Launch files with the nodes of a robot, read with a stand-in for `launch`."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from poise.model import load
from poise.session.ros2_export import launch_files
from tests.command import run_poise

ROBOT = """
robot: two
computers:
  left: {cpu: 1, memory: 1 GiB}
  right: {cpu: 1, memory: 1 GiB}
architectures:
  all:
    function: all
    components:
      talker:
        ros2: {node: "nodes:Talker", name: mouth, params: {rate: 10.0}}
      ear:
        ros2: {executable: ./nodes.py, arguments: ["it's"]}
        environment: {LEVEL: "3"}
      lidar:
        ros2: {package: lidar, executable: driver, namespace: /front, arguments: [-v]}
      logger: {command: [cat]}
      own: {implementation: "parts:Own"}
ros2: {domain: 7}
"""
NODES = """
import rclpy
from rclpy.node import Node

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.declare_parameter("rate", 1.0)
        print(self.get_name(), self.get_parameter("rate").value, flush=True)
        raise SystemExit
"""
WHERE = dict.fromkeys(("talker", "ear", "logger"), "left") | {
    "lidar": "right",
    "own": "right",
}


def actions_of(
    text: str, file: Path, monkeypatch: pytest.MonkeyPatch
) -> list[dict[str, Any]]:
    """Return what a launch file describes, with the class of each action."""

    def action(name: str, *keys: str) -> Any:
        def make(*args: str, **kwargs: Any) -> dict[str, Any]:
            return {"": name, **dict(zip(keys, args, strict=False)), **kwargs}

        return make

    modules = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "ExecuteProcess": action("ExecuteProcess"),
            "SetEnvironmentVariable": action("Set", "name", "value"),
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": action("Node")},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    namespace: dict[str, Any] = {"__file__": str(file)}
    exec(compile(text, file, "exec"), namespace)
    return namespace["generate_launch_description"]()  # type: ignore[no-any-return]


def write(folder: Path) -> Path:
    """Write the robot and its nodes into a folder; return the robot's file."""
    (folder / "nodes.py").write_text(NODES)
    path = folder / "robot.yaml"
    path.write_text(ROBOT)
    return path


def test_each_computer_starts_its_nodes_as_poise_would(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported = launch_files(load(write(tmp_path)), WHERE, "..")
    assert exported.left_out == ("own",)
    file = tmp_path / "launch" / "left.launch.py"
    domain, talker, ear, logger = actions_of(exported.texts["left"], file, monkeypatch)
    assert domain == {"": "Set", "name": "ROS_DOMAIN_ID", "value": "7"}
    assert Path(ear["cwd"]).resolve() == tmp_path
    words = ["python3", "./nodes.py", "it's"]
    assert (ear["cmd"], ear["additional_env"]) == (words, {"LEVEL": "3"})
    assert talker["cmd"][3:] == [
        *("--ros-args", "-r", "__node:=mouth"),
        *("--ros-args", "-p", "rate:=10.0"),
    ]
    assert (logger["cmd"], logger["name"]) == (["cat"], "logger")
    _, lidar = actions_of(exported.texts["right"], file, monkeypatch)
    assert lidar == {
        "": "Node",
        "package": "lidar",
        "executable": "driver",
        "arguments": ["-v", "--ros-args", "-r", "__ns:=/front"],
        "output": "screen",
        "cwd": ear["cwd"],
    }


@pytest.mark.slow  # the code is read in a process of its own
def test_the_command_writes_a_file_for_each_computer(tmp_path: Path) -> None:
    robot, where = write(tmp_path), tmp_path / "where.json"
    where.write_text(str(WHERE).replace("'", '"'))
    words = ["ros2", "export", str(robot), "--placement", str(where)]
    ended = run_poise(*words, "-o", str(tmp_path / "launch"))
    assert ended.returncode == 0, ended.stderr
    written = sorted(path.name for path in (tmp_path / "launch").iterdir())
    assert written == ["left.launch.py", "right.launch.py"]
    assert "left out: 'own'" in ended.stderr
    again = run_poise(*words, "-o", str(tmp_path / "launch"))
    assert again.returncode != 0
    assert "left.launch.py" in again.stderr
