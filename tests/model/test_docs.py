"""The reference of the robot file is complete, and its example is right."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import msgspec
import pytest

from poise.errors import FileProblem
from poise.model import robot
from poise.model.file_keys import keys_of
from poise.model.policy.policy import ACTIONS, Policy
from poise.model.policy.values import SUBJECTS, Subject
from poise.model.tasks import steps

Find = Callable[[str], tuple[FileProblem, ...]]

REFERENCE = (Path(__file__).parents[2] / "docs/robot-file.md").read_text()


def test_the_example_is_a_right_robot_file(find: Find) -> None:
    (example,) = re.findall(r"```yaml\n(robot:.*?)```", REFERENCE, re.DOTALL)
    assert find(example) == ()


@pytest.mark.parametrize(
    ("record", "heading"),
    [
        (robot.Robot, "The top level"),
        (robot.Computer, "computers"),
        (robot.Device, "devices"),
        (robot.Link, "links"),
        (robot.Architecture, "architectures"),
        (robot.ComponentEntry, "components"),
        (robot.Connector, "connectors"),
        (robot.Chain, "chains"),
        (robot.Task, "tasks"),
        *((record, "tasks") for record in get_args(steps.Step)),
        (steps.Retry, "tasks"),
        (steps.UntilKeys, "tasks"),
        (robot.ObjectiveKeys, "objective"),
        (robot.Simulator, "simulator"),
        (robot.Workload, "workload"),
        (robot.Generated, "workload"),
    ],
)
def test_every_key_is_described(record: type[msgspec.Struct], heading: str) -> None:
    text = REFERENCE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    assert [key for key in keys_of(record) if f"`{key}`" not in text] == []


@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_value_of_policies_is_described(subject: Subject) -> None:
    text = (Path(__file__).parents[2] / "docs/policies.md").read_text()
    section = text.split(f"\n### {subject}\n")[1].split("\n### ")[0]
    assert [
        name for name in keys_of(SUBJECTS[subject]) if f"`{name}`" not in section
    ] == []


def test_every_key_and_action_of_policies_is_described() -> None:
    text = (Path(__file__).parents[2] / "docs/policies.md").read_text()
    names = [*keys_of(Policy), *ACTIONS]
    assert [name for name in names if f"| `{name}` |" not in text] == []
