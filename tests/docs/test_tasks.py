"""The robot of the page about tasks is short, and does what the page says."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import Poise

Write = Callable[[str, Path], list[str]]
PAGE = "docs/tasks.md"


def test_the_robot_has_ten_lines(write_files: Write, tmp_path: Path) -> None:
    assert write_files(PAGE, tmp_path) == ["robot.yaml", "waiter.py"]
    assert len((tmp_path / "robot.yaml").read_text().splitlines()) == 10


@pytest.mark.slow
def test_its_task_runs_action_by_action_and_is_done(
    write_files: Write, poise: Poise, tmp_path: Path
) -> None:
    write_files(PAGE, tmp_path)
    file = tmp_path / "robot.yaml"
    file.write_text(file.read_text().replace("robot: waiter", "robot: tasks-page"))
    options = ["--task", "serve", "--for", "100s", "--json", "--report", "last"]
    report = json.loads(poise("run", "robot.yaml", *options).stdout)
    (task,) = report["tasks"]
    assert (task["name"], task["state"], task["why"]) == ("serve", "done", "")
    journal = json.loads(poise("journal", "last/journal.jsonl", "--json").stdout)
    said = [each["what"] for each in journal["entries"]]
    begins = [each for each in said if each.endswith("of task 'serve' begins")]
    assert begins == [
        f"action '{name}' of task 'serve' begins" for name in ("look", "go", "greet")
    ]
