"""`poise repository`, as a person or a script calls it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from poise.cli.command_table import build
from poise.errors import UsageError
from poise.estimate.outcomes import Conditions, note_outcome
from poise.model.loading import load

ROBOT = """
robot: picker
repository: [parts]
computers: {left: {cpu: 1, memory: 1 GiB}}
tasks: {tidy: {actions: [{name: pick, functions: [grasping]}]}}
"""
PARTS = """
architectures:
  gripper: {function: grasping, components: {fingers: {cpu: 10%}}}
  arm: {function: grasping, components: {hand: {devices: [arm]}}}
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "grasping.yaml").write_text(PARTS)
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return path


def call(*words: object) -> Result:
    arguments = ["repository", *map(str, words)]
    return CliRunner().invoke(build(arguments), arguments)


def test_lists_what_there_is_and_why_not_all_is_used(robot: Path) -> None:
    """With file, line and column, and a hash."""
    gripper, arm = json.loads(call("list", robot, "--json").stdout)
    assert gripper["function"] == "grasping"
    assert gripper["from"] == f"{robot.parent}/parts/grasping.yaml:3:3"
    assert (gripper["quality"], gripper["unused"]) == (1, "")
    assert len(gripper["hash"]) == 12
    assert arm["unused"] == "the robot has no device 'arm'"
    assert "not used: the robot has no device 'arm'" in call("list", robot).stdout


@pytest.mark.slow
def test_shows_what_was_learned_until_it_is_reset(robot: Path) -> None:
    """2 of 2 done, the first 2 % less by now: Beta(2.98, 1)."""
    for _ in range(2):
        note_outcome(load(robot), "pick", "done", ["gripper"])
    (learned,) = json.loads(call("show", "gripper", robot, "--json").stdout)["learned"]
    assert (learned["action"], learned["done"], learned["failed"]) == ("pick", 1.98, 0)
    assert learned["mean"] == pytest.approx(2.98 / 3.98)
    variance = 2.98 / (3.98**2 * 4.98)
    assert learned["deviation"] == pytest.approx(variance**0.5)
    assert "75% ± 19%" in call("show", "gripper", robot).stdout
    assert "2 outcomes of 'gripper' forgotten" in call("reset", "gripper", robot).stdout
    shown = json.loads(call("show", "gripper", robot, "--json").stdout)
    assert shown["learned"] == []


def test_refuses_an_unknown_architecture(robot: Path) -> None:
    """With the nearest name."""
    error = call("show", "griper", robot).exception
    assert isinstance(error, UsageError)
    assert "did you mean 'gripper'" in str(error)


def test_what_failed_without_a_computer_counts_without_it(robot: Path) -> None:
    """`poise plan --without` decides for that situation."""
    robot.write_text(ROBOT.replace("left:", "right: {cpu: 1, memory: 1 GiB}, left:"))
    both = PARTS.replace("devices: [arm]", "cpu: 10%")
    (robot.parent / "parts" / "grasping.yaml").write_text(both)
    lost = Conditions(lost=("right",))
    note_outcome(load(robot), "pick", "failed", ["gripper"], conditions=lost)

    def chosen(*options: str) -> object:
        arguments = ["plan", str(robot), "--json", *options]
        done = CliRunner().invoke(build(arguments), arguments)
        return json.loads(done.stdout)["architectures"]

    assert chosen() == {"grasping": "gripper"}
    assert chosen("--without", "right") == {"grasping": "arm"}
