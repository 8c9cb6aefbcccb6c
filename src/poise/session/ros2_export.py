"""Launch files of ROS 2 with the nodes of a robot, one for each computer; pure."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.model.check.ros2_components import ros2_environment
from poise.model.robot import Robot
from poise.model.ros2_node import Ros2Node, as_arguments
from poise.model.software import ComponentEntry

_SPIN = "import rclpy, {module} as code; rclpy.init(); rclpy.spin(code.{name}())"
_FILE = '''"""The nodes of robot {robot!r} on {computer!r}, as Poise placed them."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import ExecuteProcess, SetEnvironmentVariable
from launch_ros.actions import Node

FOLDER = str(Path(__file__).parent / {folder!r})


def generate_launch_description():
    return LaunchDescription([
{actions}
    ])
'''


class LaunchFiles(Struct, frozen=True):
    """The text of each computer's launch file, and what is in none."""

    texts: Mapping[str, str]  # computer -> Python, for each one where something runs
    # the components that ROS 2 cannot start: those of Poise, and bridges
    left_out: tuple[str, ...] = ()


def launch_files(
    robot: Robot, where: Mapping[str, str], folder: str = "."
) -> LaunchFiles:
    """Return launch files for a placement; `folder`: from them to the robot file."""
    network = ros2_environment(robot)
    common = [f"SetEnvironmentVariable({k!r}, {v!r})" for k, v in network.items()]
    actions: dict[str, list[str]] = {}
    left_out = []
    for entry in robot.components():
        if entry.name not in where:
            continue
        action = _action(entry, network)
        if action:
            actions.setdefault(where[entry.name], []).append(action)
        else:
            left_out.append(entry.name)
    texts = {
        computer: _FILE.format(
            robot=robot.name,
            computer=computer,
            folder=folder,
            actions="\n".join(f"        {a}," for a in common + actions[computer]),
        )
        for computer in sorted(actions)
    }
    return LaunchFiles(texts, tuple(left_out))


def _action(entry: ComponentEntry, network: Mapping[str, str]) -> str:
    """Return what starts a component as Poise would; empty: ROS 2 cannot."""
    words = list(entry.command if entry.ros2 is None else _words(entry.ros2))
    if not words:
        return ""
    own = {k: v for k, v in entry.environment.items() if network.get(k) != v}
    keys: dict[str, object] = {"output": "screen", "additional_env": own}
    if entry.ros2 is not None and entry.ros2.package:
        node = {"package": entry.ros2.package, "executable": entry.ros2.executable}
        return _call("Node", {**node, "arguments": words[1:], **keys})
    return _call("ExecuteProcess", {"name": entry.name, "cmd": words, **keys})


def _words(node: Ros2Node) -> tuple[str, ...]:
    if not node.node:
        program, *others = node.command()
        return ("python3" if program == "python" else program, *others)
    module, _, name = node.node.partition(":")
    code = _SPIN.format(module=module, name=name)
    return ("python3", "-c", code, *node.names(), *as_arguments(node.params))


def _call(name: str, keys: Mapping[str, object]) -> str:
    lines = [f"{key}={value!r}" for key, value in keys.items() if value]
    inner = "".join(f"            {line},\n" for line in [*lines, "cwd=FOLDER"])
    return f"{name}(\n{inner}        )"
