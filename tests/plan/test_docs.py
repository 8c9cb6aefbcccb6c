"""The example of the problem file is right, and so is its schema."""

import json
import re
from pathlib import Path

import pytest

from poise import plan
from poise.errors import RobotError

DOCS = Path(__file__).parents[2] / "docs"
REFERENCE = (DOCS / "problem-file.md").read_text()


def test_the_example_is_a_problem_with_a_placement(tmp_path: Path) -> None:
    example, soft = re.findall(r"```json\n(.*?)```", REFERENCE, re.DOTALL)
    example = json.dumps(json.loads(example) | json.loads("{" + soft + "}"))
    path = tmp_path / "problem.json"
    path.write_text(example)
    assert plan.solve(plan.load(path)).feasible


def test_the_schema_is_that_of_the_code() -> None:
    """Made anew by writing what `poise.plan.schema()` returns to the file."""
    committed = json.loads((DOCS / "problem.schema.json").read_text())
    assert committed == json.loads(plan.schema())


def test_an_unknown_key_of_the_objective_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_text('{"objective": {"comunication": 1}}')
    with pytest.raises(RobotError, match="comunication"):
        plan.load(path)
