"""What a robot says of a component that takes what others need."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from poise.estimate.online import Estimate
from poise.session.render.status_tables import remarks
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = '''
"""They spin in a timer, a call and native code; one needs what the first takes."""

import re
import time

from typing import Protocol

from poise import Component, Message, Provided, Required, every


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


class Spinner(Component):
    ticks = 0

    @every(0.1)
    def tick(self) -> None:
        self.ticks += 1
        burn(0.001 if self.ticks < 20 else 1e6)


class Sleeper(Component):
    @every(0.1)
    def look(self) -> None:
        burn(0.035)


class Holder(Component):
    """Native code that does not end, and never gives up the interpreter."""

    ticks = 0

    @every(0.1)
    def tick(self) -> None:
        self.ticks += 1
        if self.ticks == 20:
            re.match("(a+)+$", "a" * 60 + "b")


class Sum(Message):
    value: int


class Sums(Protocol):
    def add(self, sum: Sum) -> Sum: ...


class Worker(Component):
    sums: Provided[Sums]
    calls = 0

    def add(self, sum: Sum) -> Sum:
        self.calls += 1
        burn(0.001 if self.calls < 20 else 1e6)
        return sum


class Caller(Component):
    sums: Required[Sums]

    @every(0.1)
    def ask(self) -> None:
        self.sums.add(Sum(1))
'''
ROBOT = """
robot: culprits
computers:
  left: {cpu: 0.5, memory: 1 GiB}
  right: {cpu: 0.3, memory: 1 GiB}
  native: {cpu: 0.3, memory: 1 GiB}
architectures:
  work:
    function: work
    home: left
    components:
      spinner: {implementation: "culprit_code:Spinner", cpu: 2%, isolated: true}
      sleeper: {implementation: "culprit_code:Sleeper", cpu: 35%, isolated: true}
  sums:
    function: sums
    home: right
    components:
      caller: {implementation: "culprit_code:Caller", cpu: 2%}
      worker: {implementation: "culprit_code:Worker", cpu: 2%}
    connectors:
      - {between: [caller.sums, worker.sums], limit: 1 h}
  natives:
    function: natives
    home: native
    components:
      holder: {implementation: "culprit_code:Holder", cpu: 2%}
tasks:
  work: {actions: [{name: work, functions: [work, sums, natives]}]}
"""


SPINNERS = (("spinner", "left"), ("worker", "right"), ("holder", "native"))


def test_who_spins_is_seen_while_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`spinner` spins in its own timer, `worker` in a call, `holder` in native code.

    `sleeper` lacks the CPU that the first takes.
    """
    (tmp_path / "culprit_code.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    robot = poise.load("robot.yaml")
    said: list[str] = []
    placed = poise.place(robot, task="work", method="static")
    with poise.up(
        robot, task="work", placement=placed, adapt=False, say=said.append
    ) as running:

        def demands() -> dict[str, Estimate]:
            found = running.status().demand_estimates
            return {each.component: each.estimate for each in found}

        def is_told(name: str, computer: str) -> bool:
            start = f"component '{name}' on '{computer}' takes "
            return any(start in x and "a job that does not end" in x for x in said)

        def is_blamed() -> bool:
            blamed = "(component 'spinner' takes "
            remarks_now = list(remarks(running.status()))
            return any(r.startswith("sleeper") and blamed in r for r in remarks_now)

        wait_long(lambda: (d := demands().get("spinner")) and d.long_job > 0)
        wait_long(lambda: (d := demands().get("worker")) and d.mean > 0.1)
        wait_long(lambda: (d := demands().get("holder")) and d.long_job > 0)
        now = demands()
        # far more than the 2 % of before; how much the machine gives is its affair
        assert now["holder"].mean > 0.05
        assert now["spinner"].mean > 0.05
        assert now["spinner"].starved == 0.0
        assert now["caller"].mean < 0.1
        wait_long(is_blamed)
        wait_long(lambda: all(is_told(*each) for each in SPINNERS))
