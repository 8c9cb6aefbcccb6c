"""Agents that are killed under a load of messages: nothing is lost with them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet
from tests.command import robot_up
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import os
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

class Source(Component):
    numbers: Published[Number]
    sent = 0

    @every(0.002)
    def produce(self):
        self.sent += 1
        self.numbers.publish(Number(self.sent))

class Sink(Component):
    last = wrong = 0

    @subscribed(keep=1000)
    def numbers(self, message: Number):
        self.wrong += message.value != self.last + 1
        self.last = message.value
        if self.last % 25:  # a slow disk must not make the receiver the slower one
            return
        path = os.path.join(self.parameters["folder"], "sink")
        with open(path + ".new", "w") as file:
            file.write(f"{self.last} {self.wrong}")
        os.replace(path + ".new", path)
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 512 MiB}}
  right: {{cpu: 0.5, memory: 512 MiB}}
architectures:
  give:
    function: give
    components:
      source: {{implementation: "numbers_of_test:Source", only: [left], cpu: 5%,
               memory: 30 MiB}}
  take:
    function: take
    components:
      sink: {{implementation: "numbers_of_test:Sink", only: [right], cpu: 5%,
             memory: 30 MiB, parameters: {{folder: "{folder}"}}}}
connectors:
  - {{between: [source.numbers, sink.numbers], limit: 5 s}}
tasks:
  work: {{actions: [{{name: work, functions: [give, take]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "killed", "numbers_of_test", CODE, FILE)


def numbers(file: Path) -> tuple[int, int]:
    """Return the last number that came, and how often another one was due."""
    try:
        last, wrong = (file.parent / "sink").read_text().split()
    except FileNotFoundError:
        return 0, 0
    return int(last), int(wrong)


def wait_more(file: Path) -> None:
    before, _ = numbers(file)
    wait_long(lambda: numbers(file)[0] > before + 100)


def wait_restarted(robot: poise.Running, computer: str, but_not: int) -> None:
    """Wait until an agent is there, in another process."""

    def is_back() -> bool:
        status = robot.status()
        found = status.computers.get(computer)
        reached = found is not None and computer not in status.out_of_reach
        return reached and found is not None and found.pid != but_not

    wait_long(is_back)


def test_killed_agents_are_restarted_and_no_message_is_lost(
    emulated: EmulatedSet, file: Path
) -> None:
    with robot_up(file):
        robot = poise.connect(emulated.robot)
        wait_more(file)
        for computer in ("left", "right", "right", "left"):
            agent = robot.status().computers[computer].pid
            os.kill(agent, signal.SIGKILL)
            wait_restarted(robot, computer, agent)
            wait_more(file)
        status = robot.status()
    computers = status.computers.values()
    assert [len(each.took_over or ()) for each in computers] == [1, 1]
    connectors = [
        connector
        for computer in computers
        for container in computer.containers
        for connector in container.connectors
    ]
    assert [connector.drops for connector in connectors] == [0, 0]
    assert numbers(file)[1] == 0  # none lost, doubled or out of order
    assert status.placement == {"source": "left", "sink": "right"}


def test_the_agents_of_a_robot_that_is_up_on_its_own_are_restarted(file: Path) -> None:
    said: list[str] = []
    robot = poise.load(file)
    with poise.up(robot, say=said.append) as running:
        wait_more(file)
        agent = running.status().computers["right"].pid
        os.kill(agent, signal.SIGKILL)
        wait_restarted(running, "right", agent)
        wait_more(file)
        assert numbers(file)[1] == 0
        restarted = "the agent of 'right' was restarted; 1 container went on"
        wait_long(lambda: any(restarted in sentence for sentence in said))
