"""Agents as processes of their own, and components that tell how they do."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from poise.clock import SystemClock
from poise.manage.agent_connections.agents import Agents
from tests.runtime.conftest import free_port
from tests.waiting import LIMIT, wait_until

TELLING = '''
import os, threading
from typing import Protocol
from poise import Component, Message, Provided, Published, Required, every, subscribed
from poise.errors import CallError

class Number(Message):
    value: int

class Doubles(Protocol):
    def double(self, value: int) -> int: ...

class Telling(Component):
    """Writes numbers where the test reads them at once."""

    def configure(self):
        path = os.path.join(self.parameters["folder"], self.name)
        self.file = os.open(path, os.O_CREAT | os.O_WRONLY)

    def tell(self, *numbers):
        os.pwrite(self.file, b"".join(b"%10d" % n for n in numbers), 0)

class Source(Telling):
    """Publishes numbers, and asks for them to be doubled."""

    numbers: Published[Number]
    doubles: Required[Doubles]

    def configure(self):
        super().configure()
        self.sent = self.answered = self.refused = 0

    @every(0.005)
    def produce(self):
        self.sent += 1
        self.numbers.publish(Number(self.sent))
        try:
            self.answered += self.doubles.double(self.sent) == 2 * self.sent
        except CallError:
            self.refused += 1
        self.tell(self.answered, self.refused)
'''
"""The beginning of a robot's module: a component `source`, and what it speaks."""


class Told:
    """What the components `source` and `sink` tell in a folder."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def told(self, component: str) -> tuple[int, int]:
        """Return what a component tells: progress, and what went wrong."""
        with contextlib.suppress(FileNotFoundError):
            said = (self.place / component).read_bytes()
            if said:
                return int(said[:10]), int(said[10:])
        return 0, 0

    def wrong(self) -> int:
        """Return how many numbers or answers did not come as they should."""
        return self.told("sink")[1] + self.told("source")[1]

    def works(self) -> None:
        """Wait until numbers go through, and calls are answered."""
        for component in ("sink", "source"):
            before = self.told(component)[0]
            wait_until(lambda b=before, c=component: self.told(c)[0] not in {0, b})  # type: ignore[misc]


class TwoAgents(NamedTuple):
    """Two agents with what manages them."""

    folder: Path
    agents: Agents
    processes: Mapping[str, subprocess.Popen[bytes]]


@contextlib.contextmanager
def two_agents(robot: str, module: str, code: str) -> Iterator[TwoAgents]:
    """Start the agents of `left` and `right`, beside a module of the robot's."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / f"{module}.py").write_text(code)
        stack.callback(_kill_containers, folder)
        ports = {"left": free_port(), "right": free_port()}
        lifeline, held = os.pipe()
        processes = {
            name: stack.enter_context(agent(robot, name, ports, folder, lifeline))
            for name in ports
        }
        stack.callback(os.close, held)
        stack.callback(os.close, lifeline)
        ends = {name: f"tcp/127.0.0.1:{port}" for name, port in ports.items()}
        agents = stack.enter_context(Agents(robot, ends, SystemClock()))
        agents.wait_alive(ports, LIMIT)
        yield TwoAgents(folder, agents, processes)


def _kill_containers(folder: Path) -> None:
    """Kill what an agent left behind that a test has killed: it waits for the next."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if os.fsencode(f"{folder}/") in (process / "cmdline").read_bytes():
                os.kill(int(process.name), signal.SIGKILL)


def agent(
    robot: str, name: str, ports: dict[str, int], folder: Path, lifeline: int
) -> subprocess.Popen[bytes]:
    argv = [sys.executable, "-m", "poise", "agent", name, "--robot", robot]
    argv += ["--address", "127.0.0.1", "--port", str(ports[name])]
    argv += ["--folder", str(folder / name), "--lifeline", str(lifeline)]
    return subprocess.Popen(argv, pass_fds=[lifeline], stderr=subprocess.DEVNULL)
