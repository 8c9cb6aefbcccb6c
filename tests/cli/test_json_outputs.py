"""What commands print with `--json` is as the published schema says.

`tests.command.run_poise` checks it for all commands that tests run.
"""

from __future__ import annotations

import inspect
import json
from importlib import import_module
from pathlib import Path

import jsonschema
import pytest

from poise.cli.command_table import COMMANDS
from poise.cli.json_outputs import OUTPUTS, schema
from tests.command import OUTPUT_SCHEMA, called, check_output

ROOT = Path(__file__).parents[2]
HELLO = ROOT / "examples/hello/robot.yaml"
TROT = ROOT / "examples/trot/robot.yaml"


def test_the_published_schema_is_that_of_the_code() -> None:
    way_out = "run: python -m poise.cli.json_outputs > docs/output.schema.json"
    published = json.loads(OUTPUT_SCHEMA.read_text())
    assert published == json.loads(json.dumps(schema())), way_out


@pytest.mark.slow
def test_it_is_a_schema_of_draft_2020_12() -> None:
    jsonschema.Draft202012Validator.check_schema(schema())


def test_it_has_every_command_that_prints_json() -> None:
    printing = []
    for name, (where, _) in COMMANDS.items():
        module = import_module(f"poise.cli.{where}_command")
        command = getattr(module, f"{name.split()[-1]}_command")
        if {"as_json", "json"} & inspect.signature(command).parameters.keys():
            printing.append(name)
    assert sorted(printing) == sorted(OUTPUTS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["check", HELLO],
        ["check", "no-such-file.yaml"],
        ["plan", HELLO],
        ["plan", HELLO, "--explain", "printer"],
        ["plan", HELLO, "--compare", "static,auto"],
        ["plan", HELLO, "--smallest"],
        ["plan", HELLO, "--task", "no-such-task"],
        ["plan", TROT, "--task", "serve"],
        ["echo", "counter.count", "--robot", "no-such-robot"],
        ["repository", "list", TROT],
        ["repository", "show", "navigator", TROT],
        ["policy", "list", HELLO],
        ["profile", "show", TROT],
        ["emulate", "list"],
        ["list"],
        ["status", "--robot", "no-such-robot"],
    ],
    ids=lambda words: " ".join(str(word) for word in words[:2]),
)
def test_what_a_command_prints_is_as_published(words: list[object]) -> None:
    texts = [*map(str, words), "--json"]
    check_output(texts, called(texts).stdout)


def test_another_thing_is_refused() -> None:
    with pytest.raises(jsonschema.ValidationError):
        check_output(["run", "--json"], '{"robot": "hello"}')
