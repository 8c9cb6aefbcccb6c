"""A component that failed comes back by a command, once its cause is mended."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.command import robot_up, run_poise
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

NAME = f"failed{os.getpid()}"
CODE = """
import os
from pathlib import Path
from poise import Component, every

FOLDER = Path(__file__).parent

class Fragile(Component):
    def configure(self):
        if (FOLDER / "bad").exists():
            raise RuntimeError("a bad day")

    @every(0.1)
    def tick(self):
        if (FOLDER / "bad").exists():
            os._exit(3)
"""
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  work:
    function: work
    home: left
    components:
      fragile: {{implementation: "fragile:Fragile", cpu: 1%, memory: 50 MiB}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""


@pytest.mark.parametrize(
    "words", [("replace", "fragile", "fragile:Fragile"), ("move", "fragile", "right")]
)
def test_a_failed_component_starts_again(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "fragile.py").write_text(CODE)
    robot = tmp_path / "robot.yaml"
    robot.write_text(ROBOT.format(name=NAME))
    with robot_up(robot):
        (tmp_path / "bad").touch()
        wait_long(lambda: "is failed: RuntimeError: a bad day" in status())
        refused = run_poise(*words, "--robot", NAME)
        assert refused.returncode == 1
        assert "a bad day" in refused.stdout
        (tmp_path / "bad").unlink()
        done = run_poise(*words, "--robot", NAME)
        assert done.returncode == 0, done.stderr
        wait_long(lambda: "everything is as the robot file says" in status())


def status() -> str:
    return run_poise("status", "--robot", NAME).stdout
