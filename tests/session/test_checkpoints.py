"""Components that go on from their checkpoints."""

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
import os, time
from poise import Component, Message, every

class Counted(Message):
    count: int

class Counter(Component):
    count = 0

    @every(0.01)
    def tick(self):
        self.count += 1
        if self.count == 1:
            self.count = self.parameters.get("from", 1)
        path = os.path.join(self.parameters["folder"], self.name)
        with open(path + ".new", "w") as file:
            file.write(f"{self.count} {os.getpid()}")
        os.replace(path + ".new", path)
        if os.path.exists(path + ".hang"):
            os.remove(path + ".hang")
            time.sleep(1000)

    def snapshot(self):
        return Counted(self.count)

    def restore(self, state: Counted):
        self.count = state.count
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 512 MiB}}
  right: {{cpu: 0.5, memory: 512 MiB}}
architectures:
  count:
    function: count
    components:
      kept: {{implementation: "counters_of_test:Counter", cpu: 5%, memory: 30 MiB,
             isolated: true, checkpoint: 300 ms, restart_when_hung: 1 s,
             parameters: {{folder: "{folder}", from: 1000000}}}}
tasks:
  work: {{actions: [{{name: work, functions: [count]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "checkpoints", "counters_of_test", CODE, FILE)


class Watched:
    """What the component `kept` says of itself."""

    def __init__(self, file: Path) -> None:
        self._path = file.parent / "kept"

    def now(self) -> tuple[int, int]:
        """Return its count and its process."""
        try:
            count, pid = self._path.read_text().split()
        except FileNotFoundError:
            return 0, 0
        return int(count), int(pid)

    def wait_more(self, more: int = 100) -> tuple[int, int]:
        before, _ = self.now()
        wait_long(lambda: self.now()[0] > before + more)
        return self.now()

    def wait_other(self, pid: int) -> int:
        """Wait until it works in another process; return its count there."""
        wait_long(lambda: self.now()[1] not in {0, pid})
        return self.now()[0]


LAG = 200
"""What it counts in 2 s: far more than between two checkpoints."""


def last_fault(robot: poise.Running) -> str:
    """Return what the agents say of the one container."""
    (health,) = (h for c in robot.status().computers.values() for h in c.health)
    return health.last_fault.message if health.last_fault else ""


def test_a_component_goes_on_from_its_checkpoint(
    emulated: EmulatedSet, file: Path
) -> None:
    watched = Watched(file)
    with robot_up(file):
        robot = poise.connect(emulated.robot)
        watched.wait_other(0)
        count, pid = watched.wait_more(LAG)
        os.kill(pid, signal.SIGKILL)
        # 10 ms for each: lost is what it counted since its last checkpoint
        assert watched.wait_other(pid) > count - LAG
        wait_long(lambda: "'kept' restarts with its state of " in last_fault(robot))

        count, pid = watched.wait_more()
        (file.parent / "kept.hang").touch()
        count = watched.now()[0]
        assert watched.wait_other(pid) > count - LAG
        wait_long(lambda: "'kept' hangs: 'tick' runs for " in last_fault(robot))

        count, pid = watched.wait_more()
        where = robot.status().placement["kept"]
        emulated.crash(where)
        assert watched.wait_other(pid) > count - LAG
        wait_long(lambda: robot.status().placement["kept"] != where)


def test_what_is_stopped_in_order_begins_anew(
    emulated: EmulatedSet, file: Path
) -> None:
    watched = Watched(file)
    with robot_up(file):
        watched.wait_other(0)
        watched.wait_more(LAG)
    count, pid = watched.now()
    with robot_up(file):
        assert watched.wait_other(pid) < count
    for computer in emulated.computers.values():
        assert not list(computer.folder.glob("**/*.checkpoint"))
