"""Shells complete names, and say nothing where there are none."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import typer

from poise.cli.command_table import build
from poise.cli.options import in_file, running
from poise.errors import RunError
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.tasks.task_reports import TaskReport
from poise.session.running_robots import local_robots as robots_here
from poise.wire.records.request_records import ManagerId

HELLO = Path(__file__).parents[2] / "examples" / "hello" / "robot.yaml"
MANAGER = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)


def status(robot: str, *components: str) -> RobotStatus:
    return RobotStatus(
        robot=robot,
        task="work",
        manager=MANAGER,
        placement=dict.fromkeys(components, "main"),
        computers={},
        tasks=(
            TaskReport(
                name="work", state="going", priority=0, why="", began=0.0, since=0.0
            ),
        ),
    )


@pytest.fixture(autouse=True)
def _two_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two robots run, and one that does not answer."""

    def answer(name: str | None) -> Any:
        there = {
            "one": status("one", "eye", "ear"),
            "two": status("two", "eel", "hand"),
        }
        if name not in there:
            raise RunError("no answer")
        return there[name]

    class Running:
        def __init__(self, name: str | None) -> None:
            self.status = lambda: answer(name)

    monkeypatch.setattr(robots_here, "running_here", lambda: ["mute", "one", "two"])
    monkeypatch.setattr(robots_here, "Running", Running)


def context(**params: Any) -> typer.Context:
    made = typer.Context(typer.core.TyperCommand("any"))
    made.params.update(params)
    return made


def test_names_of_what_runs() -> None:
    assert running("robots")(context(), "") == ["mute", "one", "two"]
    assert running("components")(context(), "e") == ["ear", "eel", "eye"]
    assert running("components")(context(robot="two"), "") == ["eel", "hand"]
    assert running("tasks")(context(), "w") == ["work"]


def test_a_robot_that_does_not_answer_has_no_names() -> None:
    assert running("components")(context(robot="mute"), "") == []


def test_names_in_the_robot_file() -> None:
    assert in_file("tasks")(context(file=HELLO), "g") == ["greet"]
    assert in_file("computers")(context(file=str(HELLO)), "") == ["left", "right"]
    assert in_file("components")(context(file=HELLO), "p") == ["printer"]


@pytest.mark.parametrize("params", [{}, {"file": None}, {"file": Path("no such file")}])
def test_without_a_file_there_are_no_names(params: dict[str, Any]) -> None:
    assert in_file("tasks")(context(**params), "") == []


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("poise move e", ["ear", "eel", "eye"]),
        ("poise move --robot one e", ["ear", "eye"]),
        ("poise log --robot two h", ["hand"]),
        ("poise status --robot t", ["two"]),
        ("poise list con", ["connectors"]),
        ("poise k", ["keys"]),
        ("poise keys i", ["init", "issue"]),
        ("poise task ", ["start", "pause"]),
        ("poise task pause --ro", ["--robot"]),
        (f"poise emulate {HELLO} --ro", []),
        (f"poise plan {HELLO} --task g", ["greet"]),
        (f"poise plan {HELLO} --without l", ["left"]),
        (f"poise run {HELLO} --task g", ["greet"]),
        (f"poise draw {HELLO} --what t", ["transition"]),
    ],
)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_line_is_completed_in_every_shell(
    line: str,
    completed: list[str],
    shell: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = line.split(" ")
    for name, value in {
        "_POISE_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": words[-1],
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }.items():
        monkeypatch.setitem(os.environ, name, value)
    with pytest.raises(SystemExit):
        build([w for w in words[1:] if w], completes=True)(prog_name="poise")
    said = capsys.readouterr().out
    assert all(name in said for name in completed)
    assert "keys init" not in said
    assert "Usage" not in said
