"""What becomes of tasks, architectures and links when computers and networks fail."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet
from poise.errors import RunError
from poise.manage.deploy import takeover
from tests.command import robot_up
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

class Idle(Component):
    pass

class Source(Component):
    numbers: Published[Number]

    @every(0.5)
    def tick(self):
        self.numbers.publish(Number(1))

class Sink(Component):
    @subscribed(keep=10)
    def numbers(self, message: Number):
        pass
"""
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 512 MiB, resources: {{seat: 1}}}}
  right: {{cpu: 0.5, memory: 512 MiB, resources: {{seat: 1}}}}
  third: {{cpu: 0.5, memory: 512 MiB, resources: {{seat: 2}}}}
links:
  - {{between: [left, right], bandwidth: 100 Mbit/s}}
architectures:
  low:
    function: low
    priority: 1
    components:
      low: {{implementation: "losses:Idle", cpu: 1%, memory: 20 MiB,
            only: [left, right], resources: {{seat: 1}}}}
  high:
    function: high
    priority: 5
    components:
      high: {{implementation: "losses:Idle", cpu: 1%, memory: 20 MiB,
             only: [left, right], resources: {{seat: 1}}}}
  eye:
    function: eye
    components:
      eye: {{implementation: "losses:Idle", cpu: 1%, memory: 20 MiB, only: [third]}}
  talk:
    function: talk
    components:
      source: {{implementation: "losses:Source", cpu: 15%, memory: 20 MiB,
               resources: {{seat: 1}}}}
      sink: {{implementation: "losses:Sink", cpu: 15%, memory: 20 MiB,
             isolated: true, resources: {{seat: 1}}}}
    connectors:
      - {{between: [source.numbers, sink.numbers], rate: 2 Hz, message: 20 B}}
tasks:
  drive: {{actions: [{{name: drive, functions: [low, high, eye]}}], needs: [eye]}}
  talk: {{actions: [{{name: talk, functions: [talk]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "losses", "losses", CODE, ROBOT)


def is_well(robot: poise.Running) -> bool:
    status = robot.status()
    return not status.deviations and not status.out_of_reach


def is_said(robot: poise.Running, text: str) -> bool:
    return any(text in each.what for each in robot.status().deviations)


def test_a_task_stops_without_a_function_that_it_needs(
    emulated: EmulatedSet, file: Path
) -> None:
    with robot_up(file, "--task", "drive"):
        robot = poise.connect(emulated.robot)
        wait_long(lambda: is_well(robot))
        before = robot.status().placement
        emulated.crash("third")
        wait_long(
            lambda: is_said(
                robot, "task 'drive' needs function 'eye', which is missing"
            )
        )
        wait_long(lambda: robot.status().placement.keys() == {"eye"})
        emulated.boot("third")
        wait_long(lambda: robot.status().placement.keys() == before.keys())
        wait_long(lambda: is_well(robot))


def test_what_makes_room_for_higher_priorities_comes_back_when_there_is_room(
    emulated: EmulatedSet, file: Path
) -> None:
    with robot_up(file, "--task", "drive"):
        robot = poise.connect(emulated.robot)
        wait_long(lambda: is_well(robot))
        before = robot.status().placement
        emulated.crash(before["high"])
        wait_long(lambda: robot.status().placement.get("high") == before["low"])
        assert "low" not in robot.status().placement
        wait_long(lambda: is_said(robot, "architecture 'low' is suspended"))
        emulated.boot(before["high"])
        wait_long(lambda: robot.status().placement.get("low") == before["high"])
        wait_long(lambda: is_well(robot))
        assert robot.status().placement["high"] == before["low"]  # not disturbed


def lose_heartbeats(kept: EmulatedSet) -> None:
    """Let a part of what `left` sends to `right` by UDP get lost."""

    def tc(*words: str) -> str:
        argv = ["tc", *" ".join(words).split()]
        done = kept.computers["left"].popen(argv, stdout=subprocess.PIPE)
        said = done.communicate(timeout=LONG)[0].decode()
        assert done.returncode == 0
        return str(said)

    # the only class is that of its only link
    link = tc("class show dev eth0").split()[2]
    tc(f"qdisc replace dev eth0 parent {link} handle 20: htb default 1")
    tc("class add dev eth0 parent 20: classid 20:1 htb rate 100mbit")
    tc("class add dev eth0 parent 20: classid 20:2 htb rate 8kbit burst 300 cburst 300")
    tc("qdisc add dev eth0 parent 20:2 pfifo limit 1")
    tc(
        "filter add dev eth0 parent 20: protocol ip u32",
        "match ip protocol 17 0xff flowid 20:2",
    )


def test_components_leave_a_slow_link(emulated: EmulatedSet, file: Path) -> None:
    said: list[str] = []
    robot = poise.load(file)
    apart = file.with_name("apart.yaml")
    apart.write_text("{source: left, sink: right}")
    placed = poise.place(robot, task="talk", method=str(apart))
    with poise.up(robot, task="talk", placement=placed, say=said.append) as running:
        wait_long(lambda: is_well(running))
        lose_heartbeats(emulated)
        wait_long(lambda: "third" in running.status().placement.values())
    assert any("link 'left-right' is slow" in each for each in said)


def test_an_error_amid_a_takeover_leaves_the_robot_at_work(
    emulated: EmulatedSet, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RunError("a bug")

    robot = poise.load(file)
    with robot_up(file, "--task", "drive") as first:
        wait_long(lambda: is_well(poise.connect(emulated.robot)))
        first.kill()
        first.wait(LONG)
    said: list[str] = []
    monkeypatch.setattr(takeover, "adopt", fail)
    with pytest.raises(RunError, match="a bug"):
        poise.up(robot, task="drive", say=said.append).__enter__()
    monkeypatch.undo()
    with poise.up(robot, task="drive", say=said.append):
        assert any("going on with 3 components" in each for each in said)
