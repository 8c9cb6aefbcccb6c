"""`poise replace` puts an alternative in the place of an architecture that works."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.manage.control_socket.commands import RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from tests.command import robot_up, run_poise
from tests.manage.agents import Told
from tests.manage.migration.test_replacement import CODE
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

NAME = f"replaced{os.getpid()}"
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  ends:
    function: ends
    components:
      source: {{implementation: "replaced:Source", cpu: 5%, memory: 50 MiB,
               parameters: {{folder: "{folder}"}}}}
      sink: {{implementation: "replaced:Sink", cpu: 5%, memory: 50 MiB,
             parameters: {{folder: "{folder}"}}}}
  halves:
    function: adding
    components:
      counter: {{implementation: "replaced:Counter", cpu: 5%, memory: 50 MiB}}
      adder: {{implementation: "replaced:Adder", cpu: 5%, memory: 50 MiB}}
    connectors:
      - {{between: [counter.passed, adder.passed]}}
      - {{between: [counter.helps, adder.doubles], limit: 20 s}}
  one:
    function: adding
    quality: 0.5
    components:
      whole: {{implementation: "replaced:Whole", cpu: 5%, memory: 50 MiB}}
  bad:
    function: adding
    quality: 0.4
    components:
      broken: {{implementation: "replaced:Broken", cpu: 5%, memory: 50 MiB}}
connectors:
  - {{between: [source.numbers, counter.numbers], limit: 20 s}}
  - {{between: [source.doubles, counter.doubles], limit: 20 s}}
  - {{between: [adder.sums, sink.sums], limit: 20 s}}
  - {{between: [source.numbers, whole.numbers], limit: 20 s}}
  - {{between: [source.doubles, whole.doubles], limit: 20 s}}
  - {{between: [whole.sums, sink.sums], limit: 20 s}}
  - {{between: [source.numbers, broken.numbers], limit: 20 s}}
  - {{between: [source.doubles, broken.doubles], limit: 20 s}}
  - {{between: [broken.sums, sink.sums], limit: 20 s}}
tasks:
  add: {{actions: [{{name: add, functions: [ends, adding]}}]}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Start the robot; its folder is where components tell how they do."""
    (tmp_path / "replaced.py").write_text(CODE)
    robot = tmp_path / "robot.yaml"
    robot.write_text(ROBOT.format(name=NAME, folder=tmp_path))
    with robot_up(robot):
        yield tmp_path


def replace(*words: str) -> tuple[int, str]:
    done = run_poise("replace", *words, "--robot", NAME)
    return done.returncode, done.stdout + done.stderr


def run_now(*names: str) -> bool:
    answer = send_command(NAME, StatusCommand())
    assert isinstance(answer, RobotStatus)
    there = {
        component.name
        for computer in answer.computers.values()
        for container in computer.containers
        for component in container.components
    }
    return there == set(answer.placement) == {"source", "sink", *names}


def test_the_alternative_goes_on_with_the_state_or_all_is_as_before(
    folder: Path,
) -> None:
    world = Told(folder)
    world.works()
    assert run_now("counter", "adder")

    code, said = replace("halves", "ends")
    assert code == 2
    assert "provides 'ends', not 'adding'" in said

    code, said = replace("halves", "bad", "--adapt", "replaced:misadapt")
    assert code == 1
    assert said.startswith("counter stays on left and adder stays on right: ")
    assert "LookupError: no such sum" in said
    wait_long(lambda: run_now("counter", "adder"))
    world.works()

    code, said = replace("halves", "one", "--adapt", "replaced:adapt", "--json")
    assert code == 0, said
    assert json.loads(said)["by"] == "one"
    wait_long(lambda: run_now("whole"))
    world.works()

    code, said = replace("halves", "one")
    assert code == 2
    assert "architecture 'halves' does not run" in said
    # each sum is that of all numbers so far, and each answer is the right one
    assert world.wrong() == 0
