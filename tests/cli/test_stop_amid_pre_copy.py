"""`poise stop` while a large state is on its way over a slow link."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from poise.emulate import probe_host
from tests.command import POISE, robot_up, run_poise
from tests.waiting import LONG, wait_long

pytestmark = pytest.mark.slow

NAME = f"heavy{os.getpid()}"
CODE = """
import pathlib
from poise import Component, Message

class Large(Message):
    data: bytes

class Change(Message):
    pass

class Heavy(Component):
    data = bytes(50_000_000)

    def snapshot(self) -> Large:
        pathlib.Path(__file__).with_name("given").touch()
        return Large(self.data)

    def restore(self, state: Large) -> None:
        self.data = state.data

    def snapshot_delta(self) -> Change:
        return Change()

    def restore_delta(self, change: Change) -> None:
        pass
"""
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 0.9, memory: 1 GiB}}
  right: {{cpu: 0.9, memory: 1 GiB}}
links:
  - {{between: [left, right], bandwidth: 10 Mbit/s}}
architectures:
  carrying:
    function: carry
    home: left
    components:
      heavy: {{implementation: "heavy_state:Heavy", cpu: 5%, memory: 300 MiB}}
tasks:
  carry: {{actions: [{{name: carry, functions: [carry]}}]}}
"""


def test_a_stop_does_not_wait_for_a_state_that_takes_40_seconds(tmp_path: Path) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    (tmp_path / "heavy_state.py").write_text(CODE)
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.format(name=NAME))
    argv = [*POISE, "move", "heavy", "right", "--robot", NAME]
    with robot_up(file, "--placement", "static") as up:
        with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as move:
            wait_long((tmp_path / "given").exists)
            stopped = run_poise("stop", "--robot", NAME)
            told, _ = move.communicate(timeout=LONG)
        assert (stopped.returncode, stopped.stdout) == (0, "stopped\n")
        assert told == "heavy stays on left: the robot is being stopped\n"
        assert up.wait(LONG) == 0
