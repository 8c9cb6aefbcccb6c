"""`poise up` and what is asked of a running robot, as a person does it."""

from __future__ import annotations

import json
import os
import textwrap
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.errors import PoiseError
from poise.manage.control_socket.commands import RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from poise.manage.journal import Journal, read_journal
from poise.manage.migration.transition_plan import plan_transition
from poise.manage.migration.transition_run import transit
from poise.model import load
from poise.session.launch.start import started
from tests.command import robot_up, run_poise
from tests.runtime.conftest import free_port
from tests.waiting import wait_long, wait_until

pytestmark = pytest.mark.slow

NAME = f"asked{os.getpid()}"

CODE = '''
import os, time
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

def burn(seconds):
    until = time.thread_time() + seconds
    while time.thread_time() < until:
        pass

class Worker(Component):
    """Needs 2 % of a core; 45 % once there is a file of its name."""

    numbers: Published[Number]

    def configure(self):
        self.count = 0

    @every(0.05)
    def work(self):
        much = os.path.exists(os.path.join(self.parameters["folder"], self.name))
        burn(0.0225 if much else 0.001)
        self.count += 1
        self.numbers.publish(Number(self.count))

    def snapshot(self) -> Number:
        return Number(self.count)

    def restore(self, state: Number) -> None:
        self.count = state.value

class Stubborn(Worker):
    def restore(self, state: Number) -> None:
        raise LookupError("not from elsewhere")

class Reader(Component):
    """Needs 10 % of a core."""

    @subscribed(keep=10)
    def numbers(self, message: Number):
        burn(0.005)
        self.last = message.value

class Writer(Reader):
    pass
'''

ROBOT = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  working:
    function: work
    home: left
    components:
      first:
        implementation: "asked:Worker"
        isolated: true
        cpu: 30%
        memory: 50 MiB
        parameters: {{folder: "{folder}"}}
      second:
        implementation: "asked:Stubborn"
        isolated: true
        cpu: 5%
        memory: 50 MiB
        parameters: {{folder: "{folder}"}}
      reader: {{implementation: "asked:Reader", cpu: 15%, memory: 50 MiB}}
    connectors:
      - {{between: [first.numbers, reader.numbers], message: 20 B, rate: 20 Hz}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
objective: {{communication: 1, balance: 0}}
"""
TOGETHER = {"first": "left", "second": "left", "reader": "left"}


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    (tmp_path / "asked.py").write_text(textwrap.dedent(CODE))
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT.format(name=NAME, folder=tmp_path))
    return path


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def up(robot: Path, port: int) -> Iterator[Path]:
    """Start the robot."""
    beside = robot.parent
    options = ["--placement", "static", "--journal", beside / "journal"]
    options += ["--no-adapt", "--metrics", port, "--record", beside / "recording"]
    with robot_up(robot, *options):
        yield beside


def poise(*words: str) -> tuple[int, str]:
    done = run_poise(*words, "--robot", NAME)
    return done.returncode, done.stdout + done.stderr


def status() -> RobotStatus:
    answer = send_command(NAME, StatusCommand())
    assert isinstance(answer, RobotStatus)
    return answer


def test_a_running_robot_does_what_it_is_asked_and_tells_what_it_uses(
    up: Path, port: int
) -> None:
    wait_until(lambda: 'cpu_cores{component="first"' in metrics(port))

    code, said = poise("move", "reader", "right", "--json")
    assert code == 0
    assert json.loads(said)["committed"]
    assert status().placement == {**TOGETHER, "reader": "right"}

    code, said = poise("replace", "reader", "asked:Writer")
    assert code == 0
    assert "reader runs on right now" in said

    code, said = poise("move", "second", "right")
    assert code == 1
    assert "second stays on left" in said
    assert "not from elsewhere" in said

    code, said = poise("move", "nobody", "right")
    assert code == 2
    assert "nobody" in said

    code, said = poise("status")
    assert code == 0
    for name in TOGETHER:
        assert name in said
    code, said = poise("status", "--json")
    assert code == 0
    assert json.loads(said)["placement"]["reader"] == "right"

    assert poise("stop")[0] == 0
    wait_until(lambda: not is_up())
    told = [entry.what for entry in read_journal(up / "journal")]
    assert any("reader" in what for what in told)
    table = up / "table.csv"
    run_poise("recording", "export", up / "recording", "--to", table)
    assert "first" in table.read_text()


def metrics(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=20) as told:
        text: str = told.read().decode()
        return text


def is_up() -> bool:
    try:
        status()
    except PoiseError:
        return False
    return True


def test_what_needs_more_than_it_did_gets_room(up: Path) -> None:
    wait_long(is_steady)
    at_last("best as it is (proven the best)", "balance", "--dry-run")

    (up / "first").touch()  # with the reader's 10 % more than there is
    said = at_last("short", "balance", "--dry-run")
    assert "  move " in said
    assert status().placement == TOGETHER

    at_last("done; the longest downtime was", "balance")
    placed = status().placement
    assert placed["first"] != placed["reader"]

    code, said = poise("balance", "--cost", "-1")
    assert code == 2
    assert "--cost -1" in said


def is_steady() -> bool:
    return any(
        each.component == "first" and each.estimate.error is not None
        for each in status().demand_estimates
    )


def at_last(text: str, *words: str) -> str:
    """Return what a command says once it can be done and says a text.

    On a busy machine an estimate takes a while to settle.
    """
    said: list[str] = []

    def is_said() -> bool:
        code, told = poise(*words)
        said.append(told)
        return code == 0 and text in told

    wait_long(is_said)
    return said[-1]


def test_steps_taken_are_taken_back_when_one_fails(robot: Path) -> None:
    model = load(robot)
    then = {"first": "right", "second": "right", "reader": "left"}
    journal = Journal(":memory:")
    with started(model, TOGETHER, journal, lambda _: None) as robot_up:
        steps = plan_transition(model, TOGETHER, then)
        by_name = sorted(steps, key=lambda step: step.component)  # what fails goes last
        report = transit(robot_up.live, tuple(by_name))
        assert [m.what for m in report.moves] == ["first", "second", "first"]
        assert not report.committed
        assert "not from elsewhere" in report.reason
        assert robot_up.live.placement() == TOGETHER
        robot_up.live.watch(0.1)
    journal.close()
