"""No bug of Poise stops a robot: an exception in each part of the manager's tick."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import poise
from poise import threads
from poise.session.running_robots.running import Running
from poise.session.up import Up
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG), pytest.mark.one_worker]

CODE = """
import os, time
from pathlib import Path
from poise import Component, every

class Ticker(Component):
    @every(0.02)
    def tick(self):
        with Path(self.parameters["folder"], str(os.getpid())).open("a") as file:
            file.write("x")
"""
TEXT = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
links: [{{between: [left, right], bandwidth: 100 Mbit/s}}]
architectures:
  ticking:
    function: ticking
    home: left
    components:
      ticker:
        implementation: 'buggy:Ticker'
        cpu: 2%
        memory: 20 MiB
        parameters: {{folder: {folder}/ticks}}
tasks:
  tick: {{actions: [{{name: tick, functions: [ticking]}}]}}
"""


class Buggy:
    """A robot that is up, of which a test breaks parts of the manager."""

    def __init__(self, up: Up, folder: Path) -> None:
        self.up, self.folder = up, folder
        self.manager = up._manager
        self.adaptation = self.manager._adaptation

    def ticks(self) -> int:
        return sum(file.stat().st_size for file in (self.folder / "ticks").iterdir())

    def goes_on(self) -> None:
        """Wait until the component ticked again and again, in the same process."""
        seen = self.ticks()
        wait_long(lambda: self.ticks() > seen + 20)
        assert len(list((self.folder / "ticks").iterdir())) == 1


@pytest.fixture(scope="module")
def buggy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Buggy]:
    folder = tmp_path_factory.mktemp("buggy")
    (folder / "ticks").mkdir()
    robot = poise.load(written(folder, "buggy", "buggy", CODE, TEXT))
    with poise.up(robot, say=print) as up:
        found = Buggy(up, folder)
        wait_long(lambda: found.ticks() > 0)
        yield found


def said(running: Running) -> str:
    return "\n".join(each.what for each in running.status().deviations)


def break_down(*_: object, **__: object) -> None:
    raise KeyError("odd")


PARTS: dict[str, Callable[[Buggy], tuple[object, str]]] = {
    "take samples": lambda b: (b.manager._samples, "drain"),
    "look after tasks": lambda b: (b.manager.tasks, "advance"),
    "prepare the next action": lambda b: (b.manager._prefetch, "update"),
    "adapt the placement": lambda b: (b.adaptation._needs, "evaluate"),
    "wait for news": lambda b: (b.manager.tasks, "has_news"),
    "see who manages the robot": lambda b: (b.manager._live.agents, "successor"),
    "look at itself": lambda b: (b.manager.troubles, "check"),
    "bring agents to what should run": lambda b: (b.manager._live, "gateways"),
    "tell the agent of 'left' what should run": lambda b: (
        b.manager._live.reconciler,
        "step",
    ),
    "see which computers are lost": lambda b: (b.manager.lost, "note"),
    "watch components": lambda b: (b.manager._watch, "record"),
    **{
        purpose: lambda b, n=number: (b.adaptation.responders[n], "respond")  # type: ignore[misc]
        for number, purpose in enumerate(
            [
                "restart components of lost computers",
                "stop a task that lacks a needed function",
                "carry out policies",
                "start suspended architectures again",
                "plan again",
                "use computers that are back",
            ]
        )
    },
}


@pytest.mark.parametrize("part", PARTS)
def test_a_bug_in_one_part_is_said_and_the_robot_goes_on(
    buggy: Buggy, part: str
) -> None:
    where, name = PARTS[part](buggy)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(where, name, break_down)
        what = f"the manager cannot {part} (KeyError: 'odd'): a bug in Poise"
        wait_long(lambda: what in said(buggy.up))
        buggy.goes_on()
        status = buggy.up.status()
        assert status.placement == {"ticker": "left"}
    wait_long(lambda: not said(buggy.up))
    entries = buggy.up.journal()
    (failed, *_) = (e for e in entries if e.kind == "failed" and part in e.what)
    assert "break_down" in failed.facts["traceback"]
    assert os.getpid() == status.manager.pid


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_fails_is_journalled_and_said_and_the_robot_goes_on(
    buggy: Buggy,
) -> None:
    threads.daemon(break_down, "odd one").start()
    wait_long(lambda: "thread 'odd one' of the manager's process" in said(buggy.up))
    buggy.goes_on()
    (failed,) = (e for e in buggy.up.journal() if "odd one" in e.what)
    assert failed.kind == "failed"
    assert "break_down" in failed.facts["traceback"]
    # it is not shown any more a minute later
    buggy.manager.troubles._now = lambda: time.monotonic() + 2 * threads.SHOWN_FOR
    assert "odd one" not in said(buggy.up)
