"""Agents and managers of two releases work together, and follow each other at work."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest

import poise
from poise.manage.control_socket.commands import RobotStatus
from poise.wire.records.request_records import LEAST_PROTOCOL, PROTOCOL
from poise.wire.robots_here import forget
from tests.release import environment, make_release
from tests.runtime.conftest import free_port
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(2 * LONG)]

NAMES = "left", "right", "third"
CODE = """
import os
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

class Source(Component):
    numbers: Published[Number]
    sent = 0

    @every(0.005)
    def produce(self):
        self.sent += 1
        self.numbers.publish(Number(self.sent))

class Relay(Component):
    passed: Published[Number]

    @subscribed(keep=5000)
    def numbers(self, message: Number):
        self.passed.publish(message)

class Sink(Component):
    last = wrong = 0

    @subscribed(keep=5000)
    def passed(self, message: Number):
        self.wrong += message.value != self.last + 1
        self.last = message.value
        path = os.path.join(self.parameters["folder"], "sink")
        with open(path + ".new", "w") as file:
            file.write(f"{self.last} {self.wrong}")
        os.replace(path + ".new", path)
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:LEFT"}}
  right: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:RIGHT"}}
  third: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:THIRD"}}
architectures:
  give:
    function: give
    home: left
    components:
      source: {{implementation: "numbers_of_test:Source", cpu: 5%, memory: 30 MiB}}
  pass:
    function: pass
    home: right
    components:
      relay: {{implementation: "numbers_of_test:Relay", cpu: 5%, memory: 30 MiB}}
  take:
    function: take
    home: third
    components:
      sink: {{implementation: "numbers_of_test:Sink", cpu: 5%, memory: 30 MiB,
             parameters: {{folder: "{folder}"}}}}
connectors:
  - {{between: [source.numbers, relay.numbers], limit: 5 s}}
  - {{between: [relay.passed, sink.passed], limit: 5 s}}
tasks:
  work: {{actions: [{{name: work, functions: [give, pass, take]}}]}}
"""
HOMES = {"source": "left", "relay": "right", "sink": "third"}


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_release(tmp_path_factory.mktemp("before"), "0.1.0", PROTOCOL - 1)


class Site:
    """Three computers of which each has an agent of some release."""

    def __init__(self, folder: Path, closing: contextlib.ExitStack) -> None:
        self._folder = folder
        self._closing = closing
        self._ports = {name: free_port() for name in NAMES}
        text = FILE
        for name, port in self._ports.items():
            text = text.replace(name.upper(), str(port))
        self.file = written(folder, "upgrade", "numbers_of_test", CODE, text)
        self.robot = poise.load(self.file).name
        # a manager that does not reach all agents at its end leaves their addresses
        closing.callback(forget, self.robot)
        self.agents: dict[str, subprocess.Popen[bytes]] = {}

    def popen(self, python: Path, *words: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [python, "-m", "poise", *words], env=environment(), cwd=self._folder
        )
        self._closing.callback(process.wait, LONG)
        self._closing.callback(process.terminate)
        return process

    def start_agent(self, name: str, python: Path) -> None:
        words = ["agent", name, "--robot", self.robot, "--address", "127.0.0.1"]
        words += ["--port", str(self._ports[name])]
        self.agents[name] = self.popen(python, *words)

    def up(self, python: Path, *options: str) -> subprocess.Popen[bytes]:
        words = ["up", str(self.file), "--task", "work", "--placement", "static"]
        return self.popen(python, *words, *options)

    def replace_agent(self, name: str, python: Path) -> None:
        """Put an agent of another release in the place of one, as `systemctl` does."""
        old = self.agents[name]
        old.send_signal(signal.SIGUSR1)
        assert old.wait(LONG) == 0
        self.start_agent(name, python)
        wait_long(lambda: self.has_agent(name))
        self.wait_more()

    def status(self) -> RobotStatus:
        return poise.connect(self.robot).status()

    def has_agent(self, name: str) -> bool:
        status = self.status()
        computer = status.computers.get(name)
        is_there = computer is not None and name not in status.out_of_reach
        return (
            is_there and computer is not None and computer.pid == self.agents[name].pid
        )

    def numbers(self) -> tuple[int, int]:
        """Return the last number that came, and how often another one was due."""
        try:
            last, wrong = (self.file.parent / "sink").read_text().split()
        except FileNotFoundError:
            return 0, 0
        return int(last), int(wrong)

    def wait_more(self) -> None:
        before, _ = self.numbers()
        wait_long(lambda: self.numbers()[0] > before + 100)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with contextlib.ExitStack() as closing:
        yield Site(tmp_path, closing)


def test_agents_and_manager_are_upgraded_one_by_one_and_no_message_is_lost(
    site: Site, before: Path
) -> None:
    now = Path(sys.executable)
    for name in NAMES:
        site.start_agent(name, before)
    manager = site.up(before)
    site.wait_more()
    for name in NAMES:
        site.replace_agent(name, now)
    site.up(now, "--take-over")
    assert manager.wait(LONG) == 3  # another one leads
    site.wait_more()
    assert {s.version for s in site.status().computers.values()} == {version("poise")}
    site.replace_agent("right", before)  # and back, under a newer manager
    status = site.status()
    assert status.computers["right"].version == ""  # that release does not say it
    assert status.placement == HOMES
    assert [len(c.took_over or ()) for c in status.computers.values()] == [1, 1, 1]
    assert [h.restarts for c in status.computers.values() for h in c.health] == [0] * 3
    assert site.numbers()[1] == 0  # none lost, doubled or out of order


def test_a_release_two_before_is_refused_with_both_versions_and_the_way_out(
    site: Site, tmp_path: Path
) -> None:
    older = make_release(tmp_path / "older", "0.0.1", LEAST_PROTOCOL - 1)
    for name in NAMES:
        site.start_agent(name, older)
    words = ["up", str(site.file), "--task", "work"]
    done = subprocess.run(
        [sys.executable, "-m", "poise", *words],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 1
    assert (
        f"manager speaks protocol {LEAST_PROTOCOL} to {PROTOCOL}, agent 'left' (Poise "
        f"0.0.1) speaks {LEAST_PROTOCOL - 2} to {LEAST_PROTOCOL - 1}: upgrade the agent"
    ) in " ".join(done.stderr.split())
