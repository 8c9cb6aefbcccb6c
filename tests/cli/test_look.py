"""What one types first at a running robot, as a person does it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

import poise as api
from tests.command import Poise, robot_up

pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"
NAME = f"looked{os.getpid()}"
CONNECTOR = "counter.count-printer.count"


@pytest.fixture(scope="module", autouse=True)
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep a robot up for all tests of this file."""
    folder = tmp_path_factory.mktemp("looked")
    shutil.copy(HELLO / "hello.py", folder)
    text = (HELLO / "robot.yaml").read_text().replace("robot: hello", f"robot: {NAME}")
    (folder / "robot.yaml").write_text(text)
    with robot_up(folder / "robot.yaml", "--placement", "round-robin"):
        yield


def test_lists_what_runs_and_its_names(poise: Poise) -> None:
    listed = poise("list", "--robot", NAME).stdout
    assert f"robot '{NAME}', task 'greet'" in listed
    assert CONNECTOR in listed
    for what, names in {
        "robots": [NAME],
        "tasks": ["greet"],
        "computers": ["left", "right"],
        "components": ["counter", "printer"],
        "connectors": [CONNECTOR],
    }.items():
        assert poise("list", what, "--robot", NAME).stdout.split() == names
        said = poise("list", what, "--robot", NAME, "--json").stdout
        assert json.loads(said) == names
    status = json.loads(poise("list", "--robot", NAME, "--json").stdout)[NAME]
    assert status["task"] == "greet"


def test_echoes_messages_by_their_type(poise: Poise) -> None:
    done = poise("echo", "counter.count", "--robot", NAME, "--count", 3, "--json")
    values = [json.loads(line)["value"] for line in done.stdout.splitlines()]
    numbers = [value["value"] for value in values]
    assert len(numbers) == 3
    assert numbers == list(range(numbers[0], numbers[0] + 3))
    text = poise("echo", CONNECTOR, "--robot", NAME, "--count", 1).stdout
    assert text.startswith("--- ")
    assert "value: " in text


def test_measures_a_rate_also_while_the_source_moves(poise: Poise) -> None:
    running = api.connect(NAME)
    came: list[float] = []
    for number, reading in enumerate(islice(running.echo("printer.count"), 16)):
        came += reading.times
        if number == 4:
            where = running.status().placement["counter"]
            running.move("counter", "left" if where == "right" else "right")
    assert len(came) > 10
    said = json.loads(
        poise("hz", CONNECTOR, "--robot", NAME, "--count", 1, "--json").stdout
    )
    assert said["count"] > 0


def test_shows_what_components_wrote(poise: Poise) -> None:
    lines: list[str] = []
    for reading in api.connect(NAME).log("printer", follow=True):
        lines += [line.text for line in reading.lines]
        if len(lines) >= 3:
            break
    assert all(line.strip() for line in lines)
    told = poise("log", "printer", "--robot", NAME, "--last", 2, "--json").stdout
    last = [json.loads(line) for line in told.splitlines()]
    assert [each["component"] for each in last] == ["printer"] * 2
    assert f" printer@{last[0]['computer']}: " in poise("log", "--robot", NAME).stdout
    done = poise("log", "nobody", "--robot", NAME)
    assert done.returncode == 2
    assert "there are 'counter', 'printer'" in done.stderr


def test_what_is_not_there_is_refused(poise: Poise) -> None:
    done = poise("echo", "nothing", "--robot", NAME)
    assert done.returncode == 2
    assert f"no connector 'nothing' (there are: {CONNECTOR})" in done.stderr
    assert poise("list", "wishes").returncode == 2
    port = poise("echo", "counter.nope", "--robot", NAME)
    assert port.returncode == 2
    assert "'counter' publishes no 'nope'; it publishes 'count'" in port.stderr
