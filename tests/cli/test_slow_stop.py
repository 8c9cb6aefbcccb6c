"""`poise stop` says what it waits for, and a person may leave it."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.command import POISE, robot_up
from tests.waiting import LONG

pytestmark = pytest.mark.slow

NAME = f"slowstop{os.getpid()}"
CODE = """
import pathlib
import time

from poise import Component


class Slow(Component):
    def deactivate(self) -> None:
        while not pathlib.Path("may_end").exists():
            time.sleep(0.05)
"""
ROBOT = """
robot: {name}
computers: {{left: {{cpu: 0.9, memory: 1 GiB}}}}
architectures:
  parking:
    function: park
    components:
      slow: {{implementation: "slow_to_end:Slow", cpu: 5%, memory: 20 MiB}}
tasks:
  park: {{actions: [{{name: park, functions: [park]}}]}}
"""


def test_a_stop_says_what_it_waits_for_and_so_does_ctrl_c(tmp_path: Path) -> None:
    (tmp_path / "slow_to_end.py").write_text(
        CODE.replace("may_end", str(tmp_path / "may_end"))
    )
    (tmp_path / "robot.yaml").write_text(ROBOT.format(name=NAME))
    argv = [*POISE, "stop", "--robot", NAME]
    with robot_up(tmp_path / "robot.yaml") as up:
        with subprocess.Popen(argv, stderr=subprocess.PIPE, text=True) as stop:
            assert stop.stderr is not None
            waits = "the stop waits for `deactivate` and `cleanup` of 'slow'\n"
            assert stop.stderr.readline() == waits
            stop.send_signal(signal.SIGINT)
            *_, last = stop.stderr
            assert stop.wait(LONG) == 130
        assert last == f"not waiting any more; the robot is stopping: {waits}"
        (tmp_path / "may_end").touch()
        assert up.wait(LONG) == 0
