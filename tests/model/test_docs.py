"""The reference of the robot file is complete, and its example is right."""

import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from poise.errors import Problem
from poise.model import file

Find = Callable[[str], tuple[Problem, ...]]

REFERENCE = (Path(__file__).parents[2] / "docs/robot-file.md").read_text()


def test_the_example_is_a_right_robot_file(find: Find) -> None:
    (example,) = re.findall(r"```yaml\n(robot:.*?)```", REFERENCE, re.DOTALL)
    assert find(example) == ()


@pytest.mark.parametrize(
    ("section", "heading"),
    [
        (file.Robot, "The top level"),
        (file.Computer, "computers"),
        (file.Device, "devices"),
        (file.Link, "links"),
        (file.Architecture, "architectures"),
        (file.Component, "components"),
        (file.Connector, "connectors"),
        (file.Chain, "chains"),
        (file.Task, "tasks"),
        (file.Action, "tasks"),
        (file.Objective, "objective"),
        (file.Simulator, "simulator"),
        (file.Workload, "workload"),
        (file.Generated, "workload"),
    ],
)
def test_every_key_is_described(section: type[msgspec.Struct], heading: str) -> None:
    text = REFERENCE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    fields = msgspec.structs.fields(section)
    assert [f.name for f in fields if f"`{f.name}`" not in text] == []
