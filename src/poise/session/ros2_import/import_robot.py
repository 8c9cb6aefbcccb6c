"""`poise ros2 import` as a function: watch, and return the text of a robot file."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from poise.errors import RunError
from poise.session.ros2_import.graph_records import Graph
from poise.session.ros2_import.node_processes import WhereImported, relevant
from poise.session.ros2_import.robot_text import RobotText, hardware_keys
from poise.units import counted

HERE = "main"
"""What the computer is called on which the graph was observed."""


class ImportedRobot(Struct, frozen=True):
    """The text of a robot file, and the graph that it was made of."""

    text: str
    graph: Graph

    def summary(self) -> Iterator[str]:
        """Yield what was found, in sentences."""
        graph = self.graph
        nodes = sum(len(process.nodes) for process in graph.processes)
        yield (
            f"{counted(nodes, 'node')} in {counted(len(graph.processes), 'program')}, "
            f"{counted(len(graph.topics), 'topic')}; watching took "
            f"{graph.own_cpu:.1%} of a core"
        )
        for node, why in sorted(graph.elsewhere.items()):
            yield f"{node} is missing: {why}"
        yield from graph.remarks


def import_robot(
    seconds: float,
    *,
    name: str = "ros2",
    folder: Path = Path(),
    computers: Mapping[str, Mapping[str, Any]] | None = None,
) -> ImportedRobot:
    """Watch the ROS 2 graph of this environment, and return it as a robot.

    Parameters
    ----------
    seconds
        How long it is watched.
    name
        The robot's name.
    folder
        That of the robot file.
    computers
        Name -> `cpu` and `memory` as in a robot file. That called ``main`` is this one
        instead of what it has; others are added.

    Raises
    ------
    RunError
        There is no rclpy, or no node.
    """
    try:
        from poise.session.ros2_import.observer import observe
    except ImportError as error:
        raise RunError(
            f"{error}: run this where ROS 2 is: after `source /opt/ros/*/setup.bash`, "
            "or in an environment with `pip install 'poise[ros2]'`"
        ) from error
    graph = observe(seconds)
    here = WhereImported(
        folder=str(folder.resolve()),
        environment=relevant(os.environ),
        python=sys.executable,
        read=lambda file: Path(file).read_text(encoding="utf-8"),
    )
    machines = {HERE: hardware_keys(graph), **(computers or {})}
    return ImportedRobot(RobotText(graph, name, machines, here).write(), graph)
