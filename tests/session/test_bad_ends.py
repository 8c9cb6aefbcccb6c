"""Components whose last hook fails, in a robot that runs and is stopped."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from tests.command import robot_up, run_poise
from tests.session.emulated_robot import written
from tests.waiting import LONG

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
from poise import Component

class Mapper(Component):
    def cleanup(self):
        raise OSError("the map cannot be saved")
"""
TEXT = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
links: [{{between: [left, right], bandwidth: 100 Mbit/s}}]
architectures:
  mapping:
    function: mapping
    home: left
    components: {{mapper: {{implementation: 'messy:Mapper', cpu: 2%, memory: 20 MiB}}}}
tasks: {{map: {{actions: [{{name: map, functions: [mapping]}}]}}}}
"""
SAID = "says that 'cleanup' of component 'mapper' raised OSError: the map cannot be"


def test_a_run_reports_it(tmp_path: Path) -> None:
    robot = poise.load(written(tmp_path, "messy-run", "messy", CODE, TEXT))
    report = poise.run(robot, seconds=1.0)
    assert report.failed
    (fault,) = report.faults
    assert (fault.computer, fault.message[: len(SAID)]) == ("left", SAID)


def test_it_is_told_after_a_move_and_as_the_robot_stops(tmp_path: Path) -> None:
    file = written(tmp_path, "messy-up", "messy", CODE, TEXT)
    name = poise.load(file).name
    with robot_up(file) as process:
        assert run_poise("move", "--robot", name, "mapper", "right").returncode == 0
        moved = run_poise("journal", "--robot", name)
        stopped = run_poise("stop", "--robot", name)
        assert process.wait(LONG) == 1
    assert f"'left' {SAID}" in moved.stdout
    assert stopped.returncode == 1
    assert f"'right' {SAID}" in stopped.stderr
