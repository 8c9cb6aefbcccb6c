"""The example of the problem file is right, and so is its schema."""

import json
import re
from functools import reduce
from operator import or_
from pathlib import Path

import pytest

from poise import plan
from poise.errors import RobotError

DOCS = Path(__file__).parents[2] / "docs"
REFERENCE = (DOCS / "problem-file.md").read_text()


def test_the_example_is_a_problem_with_a_placement(tmp_path: Path) -> None:
    example, *more = re.findall(r"```json\n(.*?)```", REFERENCE, re.DOTALL)
    keys = [json.loads("{" + each + "}") for each in more]
    example = json.dumps(reduce(or_, keys, json.loads(example)))
    path = tmp_path / "problem.json"
    path.write_text(example)
    found = plan.solve(plan.load(path))
    assert found.feasible
    assert [time.name for time in found.times] == ["see"]


def test_the_schema_is_that_of_the_code() -> None:
    """Made anew by writing what `poise.plan.schema()` returns to the file."""
    committed = json.loads((DOCS / "problem.schema.json").read_text())
    assert committed == json.loads(plan.schema())


def test_an_unknown_key_of_the_objective_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_text('{"objective": {"comunication": 1}}')
    with pytest.raises(RobotError, match="comunication"):
        plan.load(path)
