"""The reference of the robot file is complete, and its example is right."""

import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from poise.errors import Problem
from poise.model import sections

Find = Callable[[str], tuple[Problem, ...]]

REFERENCE = (Path(__file__).parents[2] / "docs/robot-file.md").read_text()


def test_the_example_is_a_right_robot_file(find: Find) -> None:
    (example,) = re.findall(r"```yaml\n(robot:.*?)```", REFERENCE, re.DOTALL)
    assert find(example) == ()


@pytest.mark.parametrize(
    ("section", "heading"),
    [
        (sections.RobotSection, "The top level"),
        (sections.ComputerSection, "computers"),
        (sections.DeviceSection, "devices"),
        (sections.LinkSection, "links"),
        (sections.ArchitectureSection, "architectures"),
        (sections.ComponentSection, "components"),
        (sections.ConnectorSection, "connectors"),
        (sections.ChainSection, "chains"),
        (sections.TaskSection, "tasks"),
        (sections.ActionSection, "tasks"),
        (sections.ObjectiveSection, "objective"),
        (sections.SimulatorSection, "simulator"),
        (sections.WorkloadSection, "workload"),
        (sections.GeneratedSection, "workload"),
    ],
)
def test_every_key_is_described(section: type[msgspec.Struct], heading: str) -> None:
    text = REFERENCE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    fields = msgspec.structs.fields(section)
    assert [f.name for f in fields if f"`{f.name}`" not in text] == []
