"""A second manager on the other side of a cut: nothing twice, and no state is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import poise
from poise.emulate import EmulatedSet, probe_host
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]

TAKEN_OVER = 3
CODE = """
import os, time
from pathlib import Path
from poise import Component, Message, every

class Count(Message):
    value: int

class Ticker(Component):
    def configure(self):
        self.value = 0

    @every(0.02)
    def tick(self):
        self.value += 1
        with Path(self.parameters["folder"], str(os.getpid())).open("a") as file:
            file.write(f"{time.monotonic()} {self.value}\\n")

    def snapshot(self) -> Count:
        return Count(self.value)

    def restore(self, state: Count) -> None:
        self.value = state.value
"""
TEXT = """
robot: {name}
computers:
  a: {{cpu: 0.4, memory: 1 GiB}}
  b: {{cpu: 0.4, memory: 1 GiB}}
  c: {{cpu: 0.4, memory: 1 GiB}}
links:
  - {{between: [a, b], bandwidth: 100 Mbit/s}}
  - {{between: [b, c], bandwidth: 100 Mbit/s}}
  - {{between: [a, c], bandwidth: 100 Mbit/s}}
architectures:
  ticking:
    function: ticking
    home: b
    components:
      ticker:
        implementation: 'splitting:Ticker'
        cpu: 2%
        memory: 20 MiB
        only: [a, b]
        parameters: {{folder: {folder}/ticks}}
tasks:
  tick: {{actions: [{{name: tick, functions: [ticking]}}]}}
"""


class Sides:
    """A robot of three computers, and managers that run on some of them."""

    def __init__(self, kept: EmulatedSet, file: Path) -> None:
        self.kept, self.file = kept, file
        (file.parent / "ticks").mkdir()

    def start(self, computer: str, *options: str) -> subprocess.Popen[bytes]:
        """Start a manager on a computer."""
        there = self.kept.computers[computer]
        argv = [sys.executable, "-m", "poise", "up", str(self.file), *options]
        with (self.file.parent / f"{computer}.log").open("ab") as log:
            return there.popen(argv, env=self._env(computer), stdout=log, stderr=log)

    def status(self, computer: str) -> dict[str, Any]:
        """Return the status that the manager on a computer gives; empty: none."""
        argv = [sys.executable, "-m", "poise", "status", "--json"]
        done = subprocess.run(
            argv,
            env=self._env(computer),
            capture_output=True,
            timeout=LONG,
            check=False,
        )
        try:
            found: dict[str, Any] = json.loads(done.stdout)
        except ValueError:
            return {}
        return found

    def placed(self, computer: str) -> str:
        """Return where the manager on a computer has the ticker."""
        return str(self.status(computer).get("placement", {}).get("ticker", ""))

    def deviations(self, computer: str) -> str:
        """Return what the manager on a computer says is wrong."""
        found = self.status(computer).get("deviations", [])
        return "\n".join(each["what"] for each in found)

    def ticks(self) -> list[tuple[float, int, str]]:
        """Return when it ticked, with its count, and in which process."""
        return sorted(
            (float(at), int(value), file.name)
            for file in (self.file.parent / "ticks").iterdir()
            for at, _, value in (
                line.partition(" ") for line in file.read_text().split("\n")[:-1]
            )
        )

    def ticks_on(self, seen: int) -> bool:
        """Return whether it ticked a hundred times more."""
        return len(self.ticks()) > seen + 100

    def _env(self, computer: str) -> dict[str, str]:
        folder = str(self.kept.computers[computer].folder)
        return {**os.environ, "XDG_RUNTIME_DIR": folder}


def test_a_second_manager_starts_nothing_that_the_first_may_run(tmp_path: Path) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    file = written(tmp_path, "split", "splitting", CODE, TEXT)
    with poise.emulated(poise.load(file), say=print) as kept:
        sides = Sides(kept, file)
        first = sides.start("a", "--placement", "static")
        wait_long(lambda: sides.placed("a") == "b" and sides.ticks_on(0))
        kept.cut("a")
        # b's lease ends, and the first manager rightly starts it on its own side
        wait_long(lambda: sides.placed("a") == "a")
        seen = len(sides.ticks())
        wait_long(lambda: sides.ticks_on(seen))
        second = sides.start("c")
        wait_long(lambda: "another manager may run it on 'a'" in sides.deviations("c"))
        seen = len(sides.ticks())
        wait_long(lambda: sides.ticks_on(seen))
        assert first.poll() is None
        kept.heal("a")
        assert first.wait(LONG) == TAKEN_OVER
        wait_long(lambda: sides.placed("c") == "a" and not sides.deviations("c"))
        seen = len(sides.ticks())
        wait_long(lambda: sides.ticks_on(seen))
        second.terminate()
        second.wait(LONG)
    ticks = sides.ticks()
    moves = [(b, c) for b, c in pairwise(ticks) if b[2] != c[2]]
    assert len(moves) == 1  # from b to a, and never in turn
    there = [value for _, value, process in ticks if process == ticks[-1][2]]
    assert there == list(range(1, len(there) + 1))  # its state went on at the heal


def test_a_person_may_say_that_the_other_side_is_gone(tmp_path: Path) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    file = written(tmp_path, "forced", "splitting", CODE, TEXT)
    with poise.emulated(poise.load(file), say=print) as kept:
        sides = Sides(kept, file)
        sides.start("a", "--placement", "static")
        wait_long(lambda: sides.placed("a") == "b" and sides.ticks_on(0))
        kept.crash("a")
        second = sides.start("c", "--take-over")
        wait_long(lambda: sides.placed("c") == "b")
        seen = len(sides.ticks())
        wait_long(lambda: sides.ticks_on(seen))
        second.terminate()
        second.wait(LONG)
