"""What people try first: version, help, completion, a default robot, JSON errors."""

from __future__ import annotations

import json
import re
from importlib.metadata import version
from pathlib import Path

import pytest
from rich.console import Console

from poise import RobotError, place
from poise.model import Architecture, ComponentEntry, Computer, Robot
from tests.command import Poise, called

HELLO = Path(__file__).parents[2] / "examples" / "hello" / "robot.yaml"
LONG_NAME = "a_component_with_a_name_that_is_longer_than_the_terminal_is_wide" * 2


def test_it_tells_its_version(poise: Poise) -> None:
    assert poise("--version").stdout == f"poise {version('poise')}\n"


@pytest.mark.parametrize("words", [("-h",), ("run", "-h"), ("status", "-h")])
def test_h_is_help(poise: Poise, words: tuple[str, ...]) -> None:
    done = poise(*words)
    assert done.returncode == 0
    assert "Usage: poise" in done.stdout


@pytest.mark.parametrize(
    "environment",
    [  # as what `poise --install-completion` writes does
        {
            "_POISE_COMPLETE": "complete_bash",
            "COMP_WORDS": "poise\nrun\n--plac",
            "COMP_CWORD": "2",
        },
        {
            "_POISE_COMPLETE": "complete_zsh",
            "_TYPER_COMPLETE_ARGS": "poise run --plac",
        },
        {
            "_POISE_COMPLETE": "complete_fish",
            "_TYPER_COMPLETE_ARGS": "poise run --plac",
            "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        },
    ],
)
def test_every_shell_completes_the_options_of_a_command(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert "--placement" in called([]).stdout


@pytest.mark.slow
def test_the_robot_file_may_stand_in_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("POISE_ROBOT", str(HELLO))
    done = called(["check"])
    assert done.stdout == f"{HELLO}: no problems\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "kind"),
    [
        (("run", "nowhere.yaml"), 1, "RobotError"),
        (("run", str(HELLO), "--for", "soon"), 2, "UsageError"),
        (("run", str(HELLO), "--wrong"), 2, "UsageError"),
        (("status", "--robot", "nobody"), 2, "UsageError"),
    ],
)
def test_errors_are_json_where_that_is_asked_for(
    words: tuple[str, ...], code: int, kind: str
) -> None:
    done = called([*words, "--json"])
    assert done.returncode == code
    told = json.loads(done.stdout)
    assert told.keys() == {"error", "kind", "problems"}
    assert told["kind"] == kind
    assert told["error"] in done.stderr


def test_problems_of_a_file_are_in_the_json(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("robot: r\ncomputers: {a: {cup: 1}}\n")
    done = called(["run", "robot.yaml", "--json"], tmp_path)
    told = json.loads(done.stdout)
    assert told["kind"] == RobotError.__name__
    assert all(problem["line"] > 0 for problem in told["problems"])


def test_names_are_never_cut() -> None:
    console = Console(width=80)
    component = ComponentEntry(name=LONG_NAME, demand={"cpu": 0.1})
    architecture = Architecture(name="a", function="a", components=(component,))
    left = Computer(name="left", capacity={"cpu": 1.0, "memory": 1.0})
    robot = Robot(name="r", computers=(left,), architectures=(architecture,))
    with console.capture() as text:
        console.print(place(robot))
    lines = text.get().splitlines()
    assert "…" not in text.get()
    assert all(len(line) <= 80 for line in lines)
    folded = "".join(re.findall("[a-z_]{3,}", "".join(lines)))
    assert LONG_NAME[-20:] in folded
