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
from poise import Component, Message, every

FOLDER = Path(__file__).parent

class Fragile(Component):
    def configure(self):
        if (FOLDER / "bad").exists():
            raise RuntimeError("a bad day")

    @every(0.1)
    def tick(self):
        if (FOLDER / "bad").exists():
            os._exit(3)

class Count(Message):
    value: int

class Counter(Fragile):
    count = 0

    @every(0.02)
    def tick(self):
        self.count += 1
        super().tick()

    def snapshot(self):
        if self.count > 100:  # an earlier state was kept long ago
            (FOLDER / "kept").touch()
        return Count(self.count)

    def restore(self, state: Count):
        self.count = state.value
        (FOLDER / "restored").write_text(str(state.value))
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


def test_a_failed_component_goes_on_from_its_checkpoint_but_its_state_is_not_mapped(
    tmp_path: Path,
) -> None:
    (tmp_path / "fragile.py").write_text(CODE)
    robot = tmp_path / "robot.yaml"
    code = '"fragile:Counter", checkpoint: 50 ms'
    robot.write_text(ROBOT.format(name=NAME).replace('"fragile:Fragile"', code))
    replace = ("replace", "fragile", "fragile:Counter", "--robot", NAME)
    with robot_up(robot):
        wait_long((tmp_path / "kept").exists)
        (tmp_path / "bad").touch()
        wait_long(lambda: "is failed: RuntimeError: a bad day" in status())
        refused = run_poise(*replace)
        assert refused.returncode == 1
        wait_long(lambda: "is failed: RuntimeError: a bad day" in status())
        mapped = run_poise(*replace, "--adapt", "fragile:adapt")
        assert mapped.returncode == 2
        assert "'fragile' has failed, and --adapt maps the state" in mapped.stderr
        (tmp_path / "bad").unlink()
        done = run_poise(*replace)
        assert done.returncode == 0, done.stderr
        assert int((tmp_path / "restored").read_text()) > 0


def status() -> str:
    return run_poise("status", "--robot", NAME).stdout
