"""Components that crash again and again run elsewhere, or are suspended."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet
from tests.command import robot_up, run_poise
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import os
from poise import Component, Message, every

class Counted(Message):
    count: int

class Worker(Component):
    count = 0

    @every(0.05)
    def tick(self):
        self.count += 1
        here = os.readlink("/proc/self/ns/net")
        path = os.path.join(self.parameters["folder"], self.name)
        with open(path + ".new", "w") as file:
            file.write(f"{self.count} {os.getpid()} {here}")
        os.replace(path + ".new", path)
        if os.path.exists(path + ".crash"):
            with open(path + ".crash") as file:
                where = file.read()
            if where in (here, "everywhere"):
                print("a last word", flush=True)
                os._exit(3)

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
  shaky:
    function: shake
    components:
      shaky: {{implementation: "workers_of_test:Worker", cpu: 5%, memory: 30 MiB,
              checkpoint: 300 ms, parameters: {{folder: "{folder}"}}}}
  steady:
    function: stand
    components:
      steady: {{implementation: "workers_of_test:Worker", cpu: 5%, memory: 30 MiB,
               parameters: {{folder: "{folder}"}}}}
tasks:
  work: {{actions: [{{name: work, functions: [shake, stand]}}]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "crashes", "workers_of_test", CODE, FILE)


class Worker:
    """What a component says of itself, and where it is to crash."""

    def __init__(self, file: Path, name: str) -> None:
        self._path = file.parent / name

    def now(self) -> tuple[int, str, str]:
        """Return its count, its process and its computer's network."""
        try:
            count, pid, network = self._path.read_text().split()
        except FileNotFoundError:
            return 0, "", ""
        return int(count), pid, network

    def crash(self, where: str) -> None:
        """Let it crash on a computer, or everywhere, or nowhere (empty)."""
        new = self._path.with_suffix(".next")
        new.write_text(where)
        new.replace(self._path.with_suffix(".crash"))

    def wait_more(self) -> None:
        before = self.now()[0]
        wait_long(lambda: self.now()[0] > before + 20)


def test_it_runs_on_the_other_computer_and_is_put_aside_when_it_crashes_there(
    emulated: EmulatedSet, file: Path
) -> None:
    shaky, steady = Worker(file, "shaky"), Worker(file, "steady")
    with robot_up(file):
        robot = poise.connect(emulated.robot)
        steady.wait_more()
        _, neighbour, _ = steady.now()
        wait_long(lambda: shaky.now()[0] > 100)
        _, _, network = shaky.now()
        first = robot.status().placement["shaky"]

        shaky.crash(network)
        wait_long(lambda: robot.status().placement.get("shaky", first) != first)
        wait_long(lambda: shaky.now()[2] != network)
        assert shaky.now()[0] > 50  # it goes on from its checkpoint
        shaky.wait_more()

        shaky.crash("everywhere")
        wait_long(
            lambda: any("is suspended" in d.what for d in robot.status().deviations)
        )
        assert "shaky" not in robot.status().placement
        lines = next(robot.log("shaky")).lines
        assert "a last word" in [line.text for line in lines]
        done = run_poise("status", "--robot", emulated.robot)
        assert done.returncode == 1
        said = " ".join(done.stdout.split())
        assert "architecture 'shaky' is suspended: container 'shaky' crashes" in said
        assert "exit code 3" in said
        steady.wait_more()
        assert steady.now()[1] == neighbour

        shaky.crash("")
        done = run_poise("balance", "--robot", emulated.robot)
        assert done.returncode == 0, done.stderr
        wait_long(lambda: "shaky" in robot.status().placement)
        wait_long(lambda: shaky.now()[0] > 20)
        assert steady.now()[1] == neighbour
