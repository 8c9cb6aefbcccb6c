"""A component is told when nobody publishes to it any more, and when somebody does."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import poise
from poise.emulate import probe_host
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import time
from pathlib import Path
from poise import Component, Message, Published, every, found, lost, subscribed

class Count(Message):
    value: int

class Sensor(Component):
    count: Published[Count]

    def activate(self):
        Path(self.parameters["folder"], "pid").touch()

    @every(0.05)
    def tick(self):
        self.count.publish(Count(1))

class Brakes(Component):
    def write(self, what):
        with Path(self.parameters["folder"], "told").open("a") as file:
            file.write(f"{what} {time.monotonic()} {self.age('count')}\\n")

    @subscribed(keep=1)
    def count(self, message: Count) -> None: ...

    @lost("count")
    def brake(self):
        self.write("lost")

    @found("count")
    def release(self):
        self.write("found")
"""
TEXT = """
robot: {name}
computers:
  a: {{cpu: 0.4, memory: 1 GiB}}
  b: {{cpu: 0.4, memory: 1 GiB}}
links:
  - {{between: [a, b], bandwidth: 100 Mbit/s}}
architectures:
  driving:
    function: driving
    home: b
    components:
      sensor:
        implementation: 'lost_inputs:Sensor'
        cpu: 4%
        memory: 20 MiB
        only: [a]
        parameters: {{folder: {folder}}}
      brakes:
        implementation: 'lost_inputs:Brakes'
        cpu: 4%
        memory: 20 MiB
        only: [b]
        parameters: {{folder: {folder}}}
    connectors:
      - {{between: [sensor.count, brakes.count], message: 100 B, rate: 20 Hz}}
tasks:
  drive: {{actions: [{{name: drive, functions: [driving]}}]}}
"""


def test_a_component_is_told_before_the_manager_acts(tmp_path: Path) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    told = tmp_path / "told"

    def events() -> list[tuple[str, float, float]]:
        lines = told.read_text().splitlines() if told.exists() else []
        return [(w, float(at), float(age)) for w, at, age in map(str.split, lines)]

    def wait_event(what: str, number: int) -> tuple[str, float, float]:
        wait_long(lambda: len(events()) >= number)
        assert events()[number - 1][0] == what
        return events()[number - 1]

    file = written(tmp_path, "inputs", "lost_inputs", CODE, TEXT)
    robot = poise.load(file)
    with poise.emulated(robot, say=print) as kept, poise.up(robot, say=print) as run:
        wait_long((tmp_path / "pid").exists)
        time.sleep(1.5)  # not lost while it is there
        assert events() == []
        began = time.monotonic()
        kept.cut("a")
        _, at, age = wait_event("lost", 1)
        assert 0.3 < at - began < 2.0
        assert 0.3 < age < 2.0
        kept.heal("a")
        wait_event("found", 2)
        # else its computer might still be out of reach when the robot stops
        wait_long(lambda: not run.status().deviations)
