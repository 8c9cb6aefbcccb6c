"""The reference of the problem file is complete, and its example is right."""

import json
import re
from pathlib import Path

import msgspec
import pytest

from poise import plan
from poise.errors import RobotError
from poise.model.robot import Computer, Objective
from poise.plan import Bundle, Edge, Item, LinkCapacity, Problem

DOCS = Path(__file__).parents[2] / "docs"
REFERENCE = (DOCS / "problem-file.md").read_text()


def test_the_example_is_a_problem_with_a_placement(tmp_path: Path) -> None:
    (example,) = re.findall(r"```json\n(.*?)```", REFERENCE, re.DOTALL)
    path = tmp_path / "problem.json"
    path.write_text(example)
    assert plan.solve(plan.load(path)).feasible


@pytest.mark.parametrize(
    ("record", "heading"),
    [
        (Problem, "The top level"),
        (Item, "components"),
        (Computer, "computers"),
        (Edge, "connectors"),
        (LinkCapacity, "links"),
        (Bundle, "architectures"),
        (Objective, "objective"),
    ],
)
def test_every_key_is_described(record: type[msgspec.Struct], heading: str) -> None:
    section = REFERENCE.split(f"## {heading}\n")[1].split("\n## ")[0]
    for field in msgspec.structs.fields(record):
        assert f"`{field.encode_name}`" in section


def test_the_schema_is_that_of_the_code() -> None:
    """Made anew by writing what `poise.plan.schema()` returns to the file."""
    committed = json.loads((DOCS / "problem.schema.json").read_text())
    assert committed == json.loads(plan.schema())


def test_an_unknown_key_of_the_objective_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_text('{"objective": {"comunication": 1}}')
    with pytest.raises(RobotError, match="comunication"):
        plan.load(path)
