"""What pages say of files is right, and what they leave to the reference is there."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem
from poise.model.file_keys import keys_of
from poise.model.policy import ACTIONS, SUBJECTS, Subject

Find = Callable[[str], tuple[FileProblem, ...]]

ROOT = Path(__file__).parents[2]


def test_the_example_is_a_right_robot_file(find: Find) -> None:
    text = (ROOT / "docs/robot-file.md").read_text()
    (example,) = re.findall(r"```yaml\n(robot:.*?)```", text, re.DOTALL)
    assert find(example) == ()


@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_value_of_policies_has_a_description(subject: Subject) -> None:
    keys = keys_of(SUBJECTS[subject])
    assert keys
    assert [
        n for n, key in keys.items() if not (key.kind.extra or {}).get("says")
    ] == []


def test_every_action_of_policies_is_described() -> None:
    text = (ROOT / "docs/policies.md").read_text()
    assert [name for name in ACTIONS if f"| `{name}` |" not in text] == []
