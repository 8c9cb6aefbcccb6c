"""Reads a robot file into a `Robot`, or reports every problem at once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import FileProblem, RobotError
from poise.model.check.allowed_computers import (
    check_allowed_computers,
    check_checkpoints,
    check_demands,
    check_together_apart,
)
from poise.model.check.connectors import (
    check_chains,
    check_connectors,
    check_ports,
    declared_ports,
)
from poise.model.check.names import check_addresses, check_names
from poise.model.check.ros2_components import check_ros2, with_ros2
from poise.model.check.task_checks import (
    check_ends,
    check_policies,
    check_tasks,
    check_workload,
)
from poise.model.check.voting import check_voting
from poise.model.repository import Repository, with_repository
from poise.model.robot import Robot
from poise.model.yaml_include import read_tree
from poise.model.yaml_tree import Finding, Positions
from poise.model.yaml_validation import validate
from poise.units import quoted


class Source(Struct, frozen=True):
    """A robot, the locations of its parts in its files, and what the repository has."""

    robot: Robot
    positions: Positions
    repository: Repository = Repository()


def load(path: str | Path) -> Robot:
    """Return the robot that the file at `path` describes.

    Raises
    ------
    RobotError
        It contains every problem of the file and its included files.
    """
    return load_source(path).robot


def load_source(path: str | Path) -> Source:
    """Return the robot and the positions of its parts; raises as `load` does."""
    problems: list[FileProblem] = []
    path = Path(path)
    if "\0" in str(path):
        raise RobotError(f"{quoted(path)} is not a file name")
    root = read_tree(path, problems)
    if root is None:
        raise RobotError(problems=problems)
    # Names of a file that could not be included would seem unknown.
    is_whole = not problems
    values = validate(root, msgspec.inspect.type_info(Robot), problems)
    if values is None or not is_whole:
        raise RobotError(problems=sorted(problems))
    values["folder"] = str(path.resolve().parent)
    own = msgspec.convert(values, Robot)
    robot, repository = with_repository(own, root, problems)
    positions = Positions(root)
    wrong = [positions.problem(finding) for finding in check_ros2(robot)]
    robot = robot if wrong else with_ros2(robot)
    problems += wrong
    problems += [positions.problem(finding) for finding in check(robot, repository)]
    if problems:
        raise RobotError(problems=sorted(problems))
    folders = tuple(str(Path(folder).resolve()) for folder in robot.repository)
    robot = msgspec.structs.replace(robot, repository=folders)
    return Source(robot, positions, repository)


def check(robot: Robot, repository: Repository) -> Iterator[Finding]:
    """Yield every problem of `robot` that shows without its code."""
    yield from check_names(robot)
    yield from check_addresses(robot)
    yield from check_voting(robot)
    yield from check_allowed_computers(robot)
    yield from check_checkpoints(robot)
    yield from check_demands(robot)
    yield from check_together_apart(robot)
    yield from check_connectors(robot)
    yield from check_chains(robot)
    yield from check_ports(robot, declared_ports(robot))
    yield from check_workload(robot)
    yield from check_policies(robot)
    yield from check_tasks(robot, repository)
    yield from check_ends(robot, declared_ports(robot))
