"""A robot of three emulated computers, each of which may fail, and what came of it."""

from __future__ import annotations

import contextlib
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Self

from msgspec import Struct

import poise
from poise.emulate import EmulatedSet
from poise.errors import PoiseError
from poise.session.running_robots.running import Status
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_until

CODE = """
import os, time
from pathlib import Path
from poise import Component, every

class Ticker(Component):
    def configure(self):
        name = f"{self.name}.{os.getpid()}.{time.monotonic_ns()}"
        self.file = Path(self.parameters["folder"], name).open("a", buffering=1)

    @every(0.02)
    def tick(self):
        self.file.write(f"{time.monotonic()}\\n")
"""
NAMES = "abc"
TICKERS = "xyz"
FAULTS = ("kill", "cut", "flap")


def text(*, with_witness: bool) -> str:
    """Return a robot file; with a witness, computer c only votes."""
    homes = "aba" if with_witness else "abc"
    return (
        _HEAD.replace("CANDIDATES", "a, b" if with_witness else "a, b, c").replace(
            "WITNESS", ", witness: true" if with_witness else ""
        )
        + "".join(
            _TICKER.replace("NAME", name).replace("HOME", home)
            for name, home in zip(TICKERS, homes, strict=True)
        )
        + _TASKS
    )


_HEAD = """
robot: {name}
computers:
  a: {{cpu: 0.6, memory: 1 GiB}}
  b: {{cpu: 0.6, memory: 1 GiB}}
  c: {{cpu: 0.6, memory: 1 GiBWITNESS}}
links:
  - {{between: [a, b], bandwidth: 100 Mbit/s}}
  - {{between: [b, c], bandwidth: 100 Mbit/s}}
  - {{between: [a, c], bandwidth: 100 Mbit/s}}
manager: [CANDIDATES]
architectures:
"""
_TICKER = """
  tick-NAME:
    function: tick-NAME
    home: HOME
    components:
      NAME:
        implementation: 'leader_kills_robot:Ticker'
        cpu: 4%
        memory: 20 MiB
        parameters: {{folder: {folder}/ticks}}
"""
_TASKS = """
tasks:
  tick: {{actions: [{{name: tick, functions: [tick-x, tick-y, tick-z]}}]}}
  count: {{actions: [{{name: count, functions: [tick-x]}}]}}
"""
_AWAY = 20.0
"""What is not back within this time stays away [s]."""
_PAUSE = 0.5
"""A ticker that is silent for longer was away [s]."""


class Outcome(Struct, frozen=True):
    """What came of one fault; times count from it [s]."""

    fault: str
    computer: str
    was_leader: bool
    lost: tuple[str, ...]  # the tickers that ran there
    active: float  # until all tick again
    leader: float  # until a leader answers commands
    longest: float  # the longest that a ticker elsewhere did not tick meanwhile

    def __str__(self) -> str:
        """Return it in a line."""
        leads = ", the leader's" if self.was_leader else ""
        return (
            f"{self.fault} {self.computer}{leads}: "
            f"{','.join(self.lost) or 'nothing'} active after {self.active:.2f} s, "
            f"leader after {self.leader:.2f} s, others paused "
            f"{self.longest:.2f} s at most"
        )


class Kills:
    """The robot, up on its emulated computers. Use it as a context manager."""

    def __init__(self, folder: Path, *, with_witness: bool = False) -> None:
        self._folder = folder
        (folder / "ticks").mkdir()
        file = text(with_witness=with_witness)
        self._file = written(folder, "kills", "leader_kills_robot", CODE, file)
        self._stack = contextlib.ExitStack()
        self._robot = poise.load(self._file)
        self._kept: EmulatedSet
        self.outcomes: list[Outcome] = []
        self.tasks_lost = 0

    def __enter__(self) -> Self:
        log = self._stack.enter_context((self._folder / "log").open("ab"))
        self._kept = self._stack.enter_context(
            poise.emulated(self._robot, say=lambda _: None)
        )
        argv = [sys.executable, "-m", "poise", "up", str(self._file)]
        argv += ["--placement", "static"]
        first = self._kept.computers["a"].popen(
            argv, stdout=log, stderr=subprocess.STDOUT
        )
        self._stack.callback(first.wait, LONG)
        self._stack.callback(self._stop)
        wait_until(self._is_whole, LONG, 0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def kill(
        self, computer: str, back_after: float = 0.5, fault: str = "kill"
    ) -> Outcome:
        """Break a computer, wait until all is as before, and return what came of it.

        `fault`: its processes die (`kill`), nothing reaches it (`cut`), or that comes
        and goes (`flap`).
        """
        status, was_leader = self._status(), computer == self.leader()
        lost = tuple(n for n in TICKERS if status.placement[n] == computer)
        before = status.manager.pid if was_leader else 0
        self._set_task("start")
        at = time.monotonic()
        begin, end = {
            "kill": (self._kept.crash, self._kept.boot),
            "cut": (self._kept.cut, self._kept.heal),
            "flap": (self._flap, lambda _: None),
        }[fault]
        begin(computer)
        if fault == "flap":
            at, lost, before = time.monotonic(), (), 0
        active = self._after(at, lambda: self._is_active(lost, at))
        leader = self._after(at, lambda: self._answers(computer, lost, before))
        longest = max(
            (self._longest_pause(n, at) for n in TICKERS if n not in lost), default=0.0
        )
        if active < inf:
            active = max((self._first_tick(n, at) for n in lost), default=0.0)
        outcome = Outcome(fault, computer, was_leader, lost, active, leader, longest)
        self.outcomes.append(outcome)
        self.tasks_lost += "count" not in self._tasks()
        with contextlib.suppress(PoiseError):
            self._set_task("cancel")
        time.sleep(back_after)
        end(computer)
        wait_until(self._is_whole, LONG, 0.05)
        return outcome

    def _flap(self, computer: str) -> None:
        """Cut it and heal it four times, for a moment each."""
        for moment in (0.3, 0.5, 0.2, 0.7):
            self._kept.cut(computer)
            time.sleep(moment)
            self._kept.heal(computer)
            time.sleep(moment)

    def leader(self) -> str:
        """Return the computer where the leader runs."""
        manager = self._status().manager
        pid = manager.pid
        for name, computer in self._kept.computers.items():
            if pid in computer.running():
                return name
        return ""

    def ticks(self) -> dict[str, dict[str, list[float]]]:
        """Return ticker -> process -> when it ticked there [s]."""
        found: dict[str, dict[str, list[float]]] = {name: {} for name in TICKERS}
        for file in (self._folder / "ticks").iterdir():
            lines = file.read_text().split("\n")[:-1]
            if lines:
                found[file.name[0]][file.name] = [float(line) for line in lines]
        return found

    def active_twice(self) -> int:
        """Return how often a ticker ticked after a later one of its name had begun."""
        twice = 0
        for processes in self.ticks().values():
            ordered = sorted(processes.values(), key=lambda at: at[0])
            twice += sum(before[-1] > after[0] for before, after in pairwise(ordered))
        return twice

    def _after(self, at: float, holds: Callable[[], object]) -> float:
        try:
            wait_until(holds, _AWAY, 0.01)
        except AssertionError:
            return inf
        return time.monotonic() - at

    def _answers(self, computer: str, lost: tuple[str, ...], before: int) -> bool:
        """Return whether a leader answers that is not the process `before`."""
        try:
            status = self._status()
        except PoiseError:
            return False
        is_next = status.manager.pid != before
        return is_next and not any(status.placement[n] == computer for n in lost)

    def _is_active(self, lost: tuple[str, ...], at: float) -> bool:
        """Return whether all tick, those that were lost in another process."""
        again = all(self._first_tick(name, at) < inf for name in lost)
        return again and self._tick_since(at + _PAUSE)

    def _tick_since(self, since: float) -> bool:
        return all(
            any(at[-1] > since for at in processes.values())
            for processes in self.ticks().values()
        )

    def _first_tick(self, name: str, since: float) -> float:
        """Return when it began to tick in another process, after a kill [s]."""
        begun = [at[0] for at in self.ticks()[name].values() if at[0] > since]
        return min(begun, default=inf) - since

    def _longest_pause(self, name: str, since: float) -> float:
        """Return the longest that it did not tick, of all that ended after `since`."""
        moments = sorted(at for times in self.ticks()[name].values() for at in times)
        moments.append(time.monotonic())
        return max(b - a for a, b in pairwise(moments) if b > since)

    def _status(self) -> Status:
        return poise.connect(self._robot.name).status()

    def _tasks(self) -> set[str]:
        with contextlib.suppress(PoiseError):
            return {task.name for task in self._status().tasks if task.state != "done"}
        return set()

    def _set_task(self, verb: str) -> None:
        tasks = poise.connect(self._robot.name).tasks
        (tasks.start if verb == "start" else tasks.cancel)("count")

    def _is_whole(self) -> bool:
        try:
            status = self._status()
        except PoiseError:
            return False
        return not status.deviations and self._tick_since(time.monotonic() - _PAUSE)

    def _stop(self) -> None:
        with contextlib.suppress(PoiseError):
            poise.connect(self._robot.name).stop()


class Report(Struct, frozen=True):
    """What came of all kills."""

    kills: int
    active: tuple[float, ...]
    leader: tuple[float, ...]
    longest: float
    active_twice: int
    tasks_lost: int

    @classmethod
    def of(cls, kills: Kills) -> Report:
        """Return the figures of all kills so far."""
        return cls(
            kills=len(kills.outcomes),
            active=tuple(o.active for o in kills.outcomes if o.lost),
            leader=tuple(o.leader for o in kills.outcomes if o.was_leader),
            longest=max((o.longest for o in kills.outcomes), default=0.0),
            active_twice=kills.active_twice(),
            tasks_lost=kills.tasks_lost,
        )

    def figures(self) -> dict[str, float | None]:
        """Return medians and the worst [s], and counts."""
        return {
            "kills": self.kills,
            "active_median_s": statistics.median(self.active) if self.active else None,
            "active_worst_s": max(self.active, default=None),
            "leader_kills": len(self.leader),
            "leader_median_s": statistics.median(self.leader) if self.leader else None,
            "leader_worst_s": max(self.leader, default=None),
            "others_paused_worst_s": self.longest,
            "active_twice": self.active_twice,
            "tasks_lost": self.tasks_lost,
        }

    def broken(self) -> bool:
        """Return whether something must never be so."""
        away = max((*self.active, *self.leader), default=0.0) == inf
        return away or bool(self.active_twice or self.tasks_lost)
