"""The last message of a topic, in a robot whose components move, end and start."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet
from poise.errors import RunError, UsageError
from tests.command import POISE, robot_up, run_poise
from tests.view.test_robot_recording import read
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(2 * LONG)]

NAME = f"latest{os.getpid()}"
CODE = """
import os
from typing import Protocol

from poise import Component, Message, Provided, Published, published, subscribed


class Map(Message):
    number: int


class Taken(Message):
    numbers: list[int]


class Came(Protocol):
    def numbers(self) -> list[int]: ...

    def process(self) -> int: ...


class Mapper(Component):
    map: Published[Map] = published(latest=True)
    came: Provided[Came]

    def configure(self) -> None:
        self.snapshots = 0

    def numbers(self) -> list[int]:
        return [self.snapshots]

    def process(self) -> int:
        return os.getpid()

    def snapshot(self) -> None:
        self.snapshots += 1

    def restore(self, state: Map) -> None:
        raise LookupError("there is no state")


class Viewer(Component):
    came: Provided[Came]

    def configure(self) -> None:
        self.all = []

    @subscribed(block=100)
    def map(self, message: Map) -> None:
        self.all.append(message.number)

    def numbers(self) -> list[int]:
        return self.all

    def process(self) -> int:
        return os.getpid()


class Planner(Viewer):
    def snapshot(self) -> Taken:
        return Taken(self.all)

    def restore(self, state: Taken) -> None:
        self.all = state.numbers
"""
ROBOT = f"""
robot: {NAME}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  planning:
    function: planning
    home: left
    components:
      mapper: {{implementation: "{NAME}:Mapper", cpu: 5%, memory: 50 MiB,
               isolated: true, checkpoint: 100 ms}}
      planner: {{implementation: "{NAME}:Planner", cpu: 5%, memory: 50 MiB,
                isolated: true}}
    connectors:
      - {{between: [mapper.map, planner.map], limit: 5 s}}
  looking:
    function: looking
    home: right
    components:
      viewer: {{implementation: "{NAME}:Viewer", cpu: 5%, memory: 50 MiB}}
connectors:
  - {{between: [mapper.map, viewer.map]}}
tasks:
  plan: {{actions: [{{name: plan, functions: [planning]}}]}}
  look: {{actions: [{{name: look, functions: [looking]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / f"{NAME}.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path / "robot.yaml"


@pytest.fixture
def robot(emulated: EmulatedSet, file: Path) -> Iterator[poise.Running]:
    with robot_up(file, "--task", "plan"):
        yield poise.connect(emulated.robot)


def publish(robot: poise.Running, number: int) -> None:
    robot.component("mapper").publish("map", {"number": number}, limit=20.0)


def came(robot: poise.Running, component: str) -> list[int]:
    numbers = robot.component(component).call("came", "numbers", limit=20.0)
    assert isinstance(numbers, list)
    return numbers


def came_at_last(robot: poise.Running, component: str) -> list[int]:
    """Return what came; nothing while the component is not at work yet."""
    with contextlib.suppress(RunError, UsageError):
        return came(robot, component)
    return []


def look(robot: poise.Running) -> None:
    robot.tasks.start("look")
    wait_long(lambda: "viewer" in robot.status().placement)


def wait_checkpoints(robot: poise.Running, number: int) -> None:
    (before,) = came(robot, "mapper")
    wait_long(lambda: came(robot, "mapper")[0] >= before + number)


def process(robot: poise.Running, component: str) -> int:
    pid = robot.component(component).call("came", "process", limit=20.0)
    assert isinstance(pid, int)
    return pid


def kill(robot: poise.Running, component: str) -> None:
    """Kill a component's container, and wait until it works again."""
    before = process(robot, component)
    os.kill(before, signal.SIGKILL)

    def has_begun_again() -> bool:
        with contextlib.suppress(RunError):
            return process(robot, component) != before
        return False

    wait_long(has_begun_again)


def move(robot: poise.Running, component: str) -> None:
    here = robot.status().placement[component]
    robot.move(component, "left" if here == "right" else "right", force=True)


def test_each_subscriber_gets_the_last_message_once(robot: poise.Running) -> None:
    publish(robot, 1)
    publish(robot, 2)
    for component in ("planner", "mapper", "planner", "mapper"):
        move(robot, component)
    look(robot)
    wait_long(lambda: came(robot, "viewer") == [2])
    for component in ("viewer", "mapper", "viewer"):
        move(robot, component)
    wait_long(lambda: came(robot, "viewer") == [2])  # it began anew
    assert came(robot, "planner") == [1, 2]  # it has a state
    kill(robot, "planner")  # nothing keeps its state
    wait_long(lambda: came(robot, "planner") == [2])
    publish(robot, 3)
    wait_long(lambda: came(robot, "planner") == [2, 3])
    wait_long(lambda: came(robot, "viewer") == [2, 3])


def test_none_comes_twice_or_late_while_both_ends_move(robot: poise.Running) -> None:
    ended = threading.Event()

    def go_on_moving() -> None:
        while not ended.is_set():
            move(robot, "planner")
            move(robot, "mapper")

    mover = threading.Thread(target=go_on_moving)
    mover.start()
    try:
        for number in range(1, 301):
            publish(robot, number)
    finally:
        ended.set()
        mover.join()
    wait_long(lambda: len(came(robot, "planner")) >= 300)
    assert came(robot, "planner") == list(range(1, 301))


def test_a_publisher_that_was_killed_has_it_from_its_checkpoint(
    robot: poise.Running,
) -> None:
    publish(robot, 5)
    wait_long(lambda: came(robot, "planner") == [5])
    # the second checkpoint begins when the first one has been written
    wait_checkpoints(robot, 2)
    kill(robot, "mapper")
    look(robot)
    wait_long(lambda: came(robot, "viewer") == [5])
    assert came(robot, "planner") == [5]


def test_a_publisher_whose_computer_is_lost_has_it_from_its_checkpoint(
    robot: poise.Running, emulated: EmulatedSet
) -> None:
    publish(robot, 6)
    if len(set(robot.status().placement.values())) == 1:
        move(robot, "planner")
    placement = robot.status().placement
    wait_checkpoints(robot, 20)  # and the manager gets them
    emulated.crash(placement["mapper"])
    wait_long(lambda: robot.status().placement["mapper"] == placement["planner"])
    look(robot)
    wait_long(lambda: came_at_last(robot, "viewer") == [6])
    publish(robot, 7)
    wait_long(lambda: came_at_last(robot, "viewer") == [6, 7])
    assert came(robot, "planner") == [6, 7]


def test_who_looks_from_outside_sees_it_first(robot: poise.Running) -> None:
    publish(robot, 7)
    messages = robot.component("mapper").subscribe("map", dict)
    assert next(messages) == {"number": 7}
    move(robot, "mapper")
    publish(robot, 8)
    assert list(itertools.islice(messages, 1)) == [{"number": 8}]
    shown = run_poise("echo", "mapper.map", "--robot", NAME, "--count", "1").stdout
    assert "number: 8" in shown


def test_who_looks_from_outside_goes_on_after_the_publisher_was_killed(
    robot: poise.Running,
) -> None:
    publish(robot, 7)
    messages = robot.component("mapper").subscribe("map", dict)
    assert next(messages) == {"number": 7}
    wait_checkpoints(robot, 2)
    kill(robot, "mapper")
    ended = threading.Event()

    def go_on_publishing() -> None:
        for number in itertools.count(8):
            publish(robot, number)
            if ended.wait(0.2):
                return

    publisher = threading.Thread(target=go_on_publishing)
    publisher.start()
    try:
        assert next(messages)["number"] >= 8
    finally:
        ended.set()
        publisher.join()


def test_a_recording_has_it_though_nothing_goes_out(
    robot: poise.Running, tmp_path: Path
) -> None:
    publish(robot, 9)
    file = tmp_path / "last.mcap"
    words = "record", "mapper.map", "--robot", NAME, "--for", "1", "--output", str(file)
    done = run_poise(*words)
    assert done.returncode == 0, done.stderr
    (message,) = (
        message for topic, *_, message in read(file) if topic.startswith("/messages/")
    )
    assert message == {"number": 9}


def test_messages_at_a_rate_go_on_after_a_container_was_killed(
    robot: poise.Running,
) -> None:
    words = "pub", "planner.map", "{number: 1}", "--rate", "20", "--count", "60"
    argv = [*POISE, *words, "--robot", NAME]
    with subprocess.Popen(argv, stderr=subprocess.PIPE, text=True) as sending:
        wait_long(lambda: came(robot, "planner"))
        kill(robot, "planner")
        _, said = sending.communicate(timeout=LONG)
    sent, failed = re.search(r"sent (\d+) messages", said), "may be lost" in said
    assert sent, said
    assert int(sent[1]) > 50 if failed else int(sent[1]) == 60
    assert sending.returncode == failed
