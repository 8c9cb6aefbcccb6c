"""The published schema says what the loader accepts."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from poise.errors import FileProblem
from poise.model.schema import schema, schema_text

Find = Callable[[str], tuple[FileProblem, ...]]

ROOT = Path(__file__).parents[2]


def accepts(text: str) -> bool:
    validator = jsonschema.Draft202012Validator(schema())
    return bool(validator.is_valid(yaml.safe_load(text)))


def test_the_published_schema_is_that_of_the_code() -> None:
    published = (ROOT / "docs/robot.schema.json").read_text(encoding="utf-8")
    assert published == schema_text(), "run: poise check --schema"


def test_it_is_a_schema_of_draft_2020_12() -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(schema_text()))


def test_every_key_has_a_description() -> None:
    def keys(part: Any) -> Iterator[tuple[str, Any]]:
        for definition in part["$defs"].values():
            yield from definition["properties"].items()

    lacking = [key for key, part in keys(schema()) if not part.get("description")]
    assert lacking == []


@pytest.mark.parametrize("path", sorted(ROOT.glob("examples/**/robot.yaml")), ids=str)
def test_it_accepts_the_examples(path: Path) -> None:
    assert accepts(path.read_text())


START = "robot: r\ncomputers: {main: {cpu: 1, memory: 1 GiB}}\n"


@pytest.mark.parametrize(
    ("text", "is_right"),
    [
        (START, True),
        (START + "links: [{between: [a, a], latency: 0.2 ms}]", True),
        (START + "objective: {balance: -1}", False),
        (START + "objective: {scale: both}", False),
        ("robot: r\ncomputers: {main: {cpu: 20%, memory: 1}}", True),
        ("robot: r\ncomputers: {main: {cpu: 20 GB, memory: 1}}", False),
        ("robot: r\ncomputers: {main: {cpu: 1, memory: 1, reserve: 5%}}", True),
        ("robot: r\ncomputers: {main: {cpu: 1, memory: 1, sped: 1}}", False),
        ("robot: r\ncomputers: {}", False),
        ("robot: r\ncomputers: {main: {cpu: 1}}", False),
    ],
)
def test_it_agrees_with_the_validator(find: Find, text: str, is_right: bool) -> None:  # noqa: FBT001, a case
    assert accepts(text) is is_right
    problems = [p.message for p in find(text + "\n")]
    # Names that do not exist are beyond a schema.
    structural = [m for m in problems if "there is no" not in m and "itself" not in m]
    assert (not structural) is is_right
