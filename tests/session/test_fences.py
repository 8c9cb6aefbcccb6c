"""Components fence themselves when the lease of their computer ends.

Agents and whole computers are stopped and killed; each incarnation notes when it ran,
by the one monotonic clock of this machine.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet
from poise.session.launch.computers import EmulatedAgents
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import os, time
from pathlib import Path
from poise import Component, Message, Published, every, subscribed
from poise.errors import Unavailable

class Number(Message):
    value: int

class Ticker(Component):
    numbers: Published[Number]

    @every(0.02)
    def tick(self):
        self.note("tick")
        if (self.folder / "long").exists():
            (self.folder / "long").unlink()
            self.note("began")
            while not (self.folder / "go").exists():
                time.sleep(0.01)
        try:
            self.numbers.publish(Number(os.getpid()))
        except Unavailable as error:
            self.note(f"refused: {error}")
            raise
        self.note("sent")

    @property
    def folder(self):
        return Path(self.parameters["folder"])

    def note(self, what):
        with (self.folder / f"{os.getpid()}.log").open("a") as file:
            file.write(f"{time.monotonic()} {what}\\n")

class Ear(Component):
    @subscribed(keep=10)
    def numbers(self, message: Number):
        pass
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 512 MiB}}
  right: {{cpu: 0.5, memory: 512 MiB}}
  third: {{cpu: 0.5, memory: 512 MiB}}
architectures:
  tick:
    function: tick
    components:
      ticker: {{implementation: "fences:Ticker", only: [left, right], cpu: 5%,
               memory: 30 MiB, parameters: {{folder: "{folder}"}}}}
  hear:
    function: hear
    components:
      ear: {{implementation: "fences:Ear", only: [third], cpu: 5%, memory: 30 MiB}}
connectors:
  - {{between: [ticker.numbers, ear.numbers]}}
tasks:
  work: {{actions: [{{name: work, functions: [tick, hear]}}]}}
"""


class Watched:
    """A robot that is up, and what the incarnations of `ticker` noted."""

    def __init__(self, folder: Path, up: poise.Running) -> None:
        self.folder = folder
        self.up = up

    @property
    def computer(self) -> str:
        """Where it is."""
        return self.up.status().placement["ticker"]

    def agent(self) -> int:
        """Return the process of the agent there."""
        return self.up.status().computers[self.computer].pid

    def processes(self) -> list[int]:
        """Return the processes of its incarnations, in their order."""
        pids = [int(log.stem) for log in self.folder.glob("*.log")]
        began = {pid: notes[0][0] for pid in pids if (notes := self.notes(pid))}
        return sorted(began, key=lambda pid: began[pid])

    def notes(self, pid: int) -> list[tuple[float, str]]:
        """Return what an incarnation noted, and when [s]."""
        lines = (self.folder / f"{pid}.log").read_text().split("\n")[:-1]
        return [(float(at), what) for at, _, what in (s.partition(" ") for s in lines)]

    def said(self, pid: int) -> set[str]:
        return {what.partition(":")[0] for _, what in self.notes(pid)}

    def wait_well(self) -> None:
        def is_well() -> bool:
            status = self.up.status()
            return not status.deviations and not status.out_of_reach

        wait_long(is_well)
        self.wait_ticks(self.processes()[-1])

    def wait_ticks(self, pid: int) -> None:
        before = len(self.notes(pid))
        wait_long(lambda: len(self.notes(pid)) > before + 40)

    def wait_other(self, pid: int) -> int:
        """Wait until another incarnation works; return its process."""
        wait_long(lambda: self.processes()[-1] != pid)
        self.wait_ticks(self.processes()[-1])
        return self.processes()[-1]

    def overlaps(self) -> list[tuple[int, list[str]]]:
        """Return which worked beside a later one, and what they noted meanwhile.

        A process may be stopped just after it looked at its lease: so one note, of a
        handler that had begun or of a message that had gone out, may come late.
        """
        found, pids = [], self.processes()
        for one, other in pairwise(pids):
            began = self.notes(other)[0][0]
            late = [what for at, what in self.notes(one) if at > began]
            if [what for what in late[1:] if not what.startswith("refused")]:
                found.append((one, late))
        return found


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path, "fences", "fences", CODE, FILE)


@pytest.fixture
def watched(emulated: EmulatedSet, file: Path) -> Iterator[Watched]:  # noqa: ARG001
    with poise.up(poise.load(file), say=print) as up:
        watched = Watched(file.parent, up)
        wait_long(watched.processes)
        watched.wait_well()
        yield watched


def test_what_a_stopped_agent_runs_stops_before_it_starts_elsewhere(
    watched: Watched,
) -> None:
    (old,), agent = watched.processes(), watched.agent()
    os.kill(agent, signal.SIGSTOP)
    try:
        watched.wait_other(old)
        watched.wait_ticks(watched.processes()[-1])
    finally:
        os.kill(agent, signal.SIGCONT)
    watched.wait_well()
    assert watched.overlaps() == []
    assert len(watched.processes()) == 2


def test_a_handler_that_outlives_the_lease_may_not_publish(watched: Watched) -> None:
    (old,), agent = watched.processes(), watched.agent()
    (watched.folder / "long").touch()
    wait_long(lambda: "began" in watched.said(old))
    os.kill(agent, signal.SIGSTOP)
    try:
        watched.wait_other(old)
        (watched.folder / "go").touch()
        wait_long(lambda: "refused" in watched.said(old))
    finally:
        os.kill(agent, signal.SIGCONT)
    watched.wait_well()
    assert watched.overlaps() == []
    assert watched.notes(old)[-1][1].startswith("refused: component 'ticker' is inact")


def test_a_handler_that_outlives_the_lease_is_killed_by_its_agent(
    watched: Watched, emulated: EmulatedSet
) -> None:
    (old,), computer = watched.processes(), watched.computer
    (watched.folder / "long").touch()
    wait_long(lambda: "began" in watched.said(old))
    emulated.cut(computer)
    watched.wait_other(old)
    wait_long(lambda: not Path(f"/proc/{old}").exists())
    emulated.heal(computer)
    watched.wait_well()
    assert watched.notes(old)[-1][1] == "began"
    said = [fault.message for fault in watched.up.status().computers[computer].faults]
    assert any("'ticker' still ran 0.5 s after the computer's" in s for s in said), said


def test_a_computer_that_was_paused_wakes_up_fenced(
    watched: Watched, emulated: EmulatedSet
) -> None:
    (old,), computer = watched.processes(), watched.computer
    emulated.freeze(computer)
    watched.wait_other(old)
    emulated.boot(computer)
    watched.wait_well()
    assert watched.overlaps() == []


def test_a_stopped_container_is_active_nowhere_else(watched: Watched) -> None:
    (old,) = watched.processes()
    os.kill(old, signal.SIGSTOP)
    wait_long(lambda: watched.up.status().deviations)
    os.kill(old, signal.SIGCONT)
    watched.wait_well()
    assert watched.processes() == [old]


def test_what_ended_with_all_processes_of_its_computer_starts_elsewhere_at_once(
    watched: Watched, emulated: EmulatedSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The computer itself still answers; formerly that took 11 s."""
    monkeypatch.setattr(EmulatedAgents, "_look_after", lambda *_: None)
    (old,) = watched.processes()
    killed_at = time.monotonic()
    for process in emulated.computers[watched.computer].running():
        os.kill(process, signal.SIGKILL)
    new = watched.wait_other(old)
    took = watched.notes(new)[0][0] - killed_at
    assert took < 9.0, took
    monkeypatch.undo()  # the agent is started again
    watched.wait_well()
